"""One cluster `test` with the platform on it, shared by all tests that need one, and the story run on it once.

ROBOTKUBE_KEEP_CLUSTER=1 leaves it running at the end, to look around or for the next run.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from running_platform import NAME, SCENARIO, STEPS, VARIANT, Platform, spoken
from story import Story, play

from ci import demo
from ci.cluster import cleaning
from ci.cluster.embedded import Embedded
from ci.steps import Steps
from scenarios import definition
from scenarios.runner.access import Access

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
    "test_how_to",
    "test_refusals",
    "test_lifecycle",
    "test_interrupting",
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
    if cleaning.leftovers("demo"):
        with spoken(pytestconfig):
            print("\nstopping the cluster demo: only one can run at a time", file=sys.stderr, flush=True)
            Embedded("demo", Path()).down()


@pytest.fixture(scope="session")
def platform(pytestconfig: pytest.Config, no_demo: None) -> Iterator[Platform]:
    """The cluster of the small scenario with Argo CD, the platform, and images, charts and catalogue published."""
    scenario = definition.load(SCENARIO, [], VARIANT)
    with spoken(pytestconfig):
        print(file=sys.stderr)
        request = demo.Request(SCENARIO, {"vehicles": str(scenario.parameters.vehicles)}, NAME, "platform")
        installer = demo.bring_up(request, Steps(STEPS))
    provider = Embedded(NAME, installer.binaries)
    access = Access(installer.kubeconfig)
    yield Platform(installer, provider, access, scenario)
    access.disconnect()
    if os.environ.get("ROBOTKUBE_KEEP_CLUSTER") != "1":
        provider.down()
        assert cleaning.leftovers(NAME) == ()


@pytest.fixture(scope="session")
def story(pytestconfig: pytest.Config, platform: Platform, tmp_path_factory: pytest.TempPathFactory) -> Story:
    """The small scenario, run once from its first pull request to its report."""
    with spoken(pytestconfig):
        print("\nthe small scenario runs, two minutes", file=sys.stderr, flush=True)
        return play(platform, SCENARIO, VARIANT, tmp_path_factory.mktemp("story"))
