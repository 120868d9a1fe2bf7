"""One cluster `test` with the platform on it, shared by all tests that need one, and the story run on it once.

ROBOTKUBE_KEEP_CLUSTER=1 leaves it running at the end, to look around or for the next run.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.stages.platform.running_platform import SCENARIO, VARIANT, Platform, shared, spoken, stop_demo, take_down
from tests.stages.platform.story import Story, play
from tests.stages.platform.table_one import Stage, on_stage

# The first starts and removes clusters itself. Those that leave the platform changed come right before the stories of
# Table I, and after them those that put clusters of their own in the place of the shared one.
ORDER = (
    "cluster/test_embedded_provider",
    "cluster/test_images",
    "cluster/test_database",
    "cluster/test_network",
    "cluster/test_rights",
    "suites/test_suites",
    "suites/test_refused_submissions",
    "suites/test_interface",
    "suites/test_trying",
    "cluster/test_story",
    "cluster/test_console",
    "cluster/test_bridges",
    "cluster/test_installation",
    "cluster/test_monitoring",
    "cluster/test_admission",
    "cluster/test_inspection",
    "cluster/test_removal",
    "cluster/test_restoring",
    "cluster/test_sharing",
    "cluster/test_three_vehicles",
    "cluster/test_withdrawing",
    "cluster/test_observing",
    "cluster/test_task_gateway",
    "cluster/test_rule_reload",
    "cluster/test_how_to",
    "cluster/test_how_to_detector",
    "cluster/test_own_images",
    "cluster/test_agents",
    "cluster/test_enrolled_in_mid_run",
    "cluster/test_updates",
    "cluster/test_results",
    "cluster/test_broken_links",
    "cluster/test_containers",
    "cluster/test_refusals",
    *(f"table_one/test_p{number:02}" for number in range(1, 11)),
    "cluster/test_lifecycle",
    "cluster/test_upgrade_under_load",
    "cluster/test_short_certificates",
    "cluster/test_refusals_without_admission",
    "cluster/test_other_cluster",
    "cluster/test_managed_services",
    "cluster/test_managed_forge",
    "cluster/test_cluster_of_others",
    "cluster/test_installed_from_registry",
    "kind/test_use_case_on_kind",
    "kind/test_existing_on_kind",
    "cluster/test_interrupting",
    "cluster/test_scenarios",
)
HERE = Path(__file__).parent


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their markers
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks the tests below this folder; they come last, in this order of their files."""
    ours = [item for item in items if HERE in item.path.parents]
    for item in ours:
        item.add_marker(pytest.mark.platform)
    items[:] = [item for item in items if HERE not in item.path.parents] + sorted(ours, key=_place)


def _place(item: pytest.Item) -> int:
    return ORDER.index(item.path.relative_to(HERE).with_suffix("").as_posix())


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
