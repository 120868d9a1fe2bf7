"""Where there is no admission, Argo CD itself refuses what reaches main past manager and gate and asks for more than a
release may: on a cluster `test` of its own, with ROBOTKUBE_ADMISSION=off."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from ci.cluster.choosing import Choice
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.provider import Embedded
from ci.steps import Steps
from scenarios import definition, demo
from scenarios.runner.platform.access import Access
from tests.stages.platform.running_platform import (
    NAME,
    SCENARIO,
    STEPS,
    VARIANT,
    Platform,
    asleep,
    eventually,
    spoken,
)
from tests.stages.platform.unchecked_releases import (
    REFUSED_SECONDS_MAX,
    application,
    bring_to_main,
    conditions,
    reached_nothing,
)

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def platform(
    pytestconfig: pytest.Config, no_demo: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Platform]:
    """The platform without admission, with the three releases on main; its manager would take them away."""
    scenario = definition.load(SCENARIO, [], VARIANT)
    settings = {"vehicles": str(len(scenario.vehicles))}
    Embedded(NAME, Path()).down()
    with pytest.MonkeyPatch.context() as patch, spoken(pytestconfig):
        patch.setenv(admission_files.VARIABLE, admission_files.OFF)
        installer = demo.bring_up(demo.Request(SCENARIO, settings, Choice(NAME), "platform"), Steps(STEPS))
        installed = Platform(installer, Embedded(NAME, installer.binaries), Access(installer.kubeconfig), scenario)
    eventually("all Applications synced and healthy", installed.settled)
    with asleep(installed, "manager"):
        bring_to_main(installed, tmp_path_factory.mktemp("releases"))
        yield installed
    installed.access.disconnect()
    if os.environ.get("ROBOTKUBE_KEEP_CLUSTER") != "1":
        installed.provider.down()


def refusal(platform: Platform, name: str, *words: str) -> None:
    """Argo CD has said all of these words against a release, and compared nothing."""

    def said() -> bool:
        text = conditions(application(platform, name))
        return all(word in text for word in words)

    eventually(f"{name} is refused", said, REFUSED_SECONDS_MAX)
    state = application(platform, name)["status"]
    assert (state["sync"]["status"], "operationState" in state) == ("Unknown", False)


def test_a_cluster_role_is_refused_with_its_whole_release(platform: Platform) -> None:
    """Argo CD may not even read one, so it compares nothing; if it might, the AppProject would refuse it."""
    refusal(platform, "everything", "ComparisonError", 'cannot get resource "clusterroles"')
    assert reached_nothing(platform)


def test_a_chart_from_elsewhere_is_refused(platform: Platform) -> None:
    refusal(platform, "foreign", "InvalidSpecError", "is not permitted in project 'robotkube-apps'")
    assert reached_nothing(platform)


def test_a_digest_that_the_registry_does_not_have_changes_nothing(platform: Platform) -> None:
    refusal(platform, "unknown", "ComparisonError", "not found")
    assert reached_nothing(platform)
