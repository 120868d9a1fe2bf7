"""One cluster `test` with the platform on it, shared by all tests that need one, and the story run on it once.

ROBOTKUBE_KEEP_CLUSTER=1 leaves it running at the end, to look around or for the next run.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "table_one"))

from running_platform import SCENARIO, VARIANT, Platform, shared, spoken, stop_demo, take_down
from stage import Stage, on_stage
from story import Story, play

# The first starts and removes clusters itself; the last ones leave the platform changed.
ORDER = (
    "test_embedded_provider",
    "test_images",
    "test_database",
    "test_rights",
    "test_suites",
    "test_refused_submissions",
    "test_suite_interface",
    "test_story",
    "test_bridges",
    "test_restoring",
    "test_three_vehicles",
    "test_withdrawing",
    "test_observing",
    "test_doors",
    "test_rule_reload",
    "test_how_to",
    "test_how_to_detector",
    "test_agents",
    "test_updates",
    "test_refusals",
    "test_lifecycle",
    "test_interrupting",
    "test_scenarios",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Orders the files of this folder among themselves; tests of other folders stay where they are."""
    here = Path(__file__).parent
    places = [place for place, item in enumerate(items) if item.path.parent == here]
    ordered = sorted((items[place] for place in places), key=lambda item: ORDER.index(item.path.stem))
    for place, item in zip(places, ordered, strict=True):
        item.add_marker(pytest.mark.cluster)
        items[place] = item


@pytest.fixture(scope="session")
def no_demo(pytestconfig: pytest.Config) -> None:
    """A running demo is stopped, and that is said: only one cluster runs at a time."""
    stop_demo(pytestconfig)


@pytest.fixture(scope="session")
def platform(pytestconfig: pytest.Config, no_demo: None) -> Iterator[Platform]:
    """The cluster with Argo CD, the platform, and images, charts and catalogue published."""
    yield shared(pytestconfig)
    take_down()


@pytest.fixture(scope="session")
def story(pytestconfig: pytest.Config, platform: Platform, tmp_path_factory: pytest.TempPathFactory) -> Story:
    """The small scenario, run once from its first pull request to its report."""
    with spoken(pytestconfig):
        print("\nthe small scenario runs, two minutes", file=sys.stderr, flush=True)
        return play(platform, SCENARIO, VARIANT, tmp_path_factory.mktemp("story"))


@pytest.fixture
def stage(platform: Platform) -> Iterator[Stage]:
    """Begins with everything as main asks for, and ends with main asking for what it did before."""
    with on_stage(platform) as stage:
        yield stage
