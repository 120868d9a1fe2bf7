"""A task whose service got other settings in the same pod is Ready when two probes have found them at work."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotkube.delivery.deployment.core.releases import application_name
from robotkube.delivery.manager.adapters.kubernetes_cluster import read_application
from robotkube.delivery.manager.core.changed_settings import PROBED_NS, SECOND_NS, SettingsProofs
from robotkube.delivery.manager.core.observation import ApplicationState, ContainerState, PodState
from robotkube.delivery.manager.loops.reconciler import APPLICATIONS
from tests.stages.delivery.manager.manager_in_memory import START_NS, Stage

OLD = ContainerState("relay", probed=True, ready=True, started_ns=START_NS - SECOND_NS)


def service(stage: Stage, key: str) -> str:
    """A release of the task that is no bridge."""
    releases = stage.tasks.objects[key]["status"]["releases"]
    return str(next(release for release in releases if not release.endswith("/mqtt-bridge")))


def applied(stage: Stage, release: str, container: ContainerState, health: str = "Healthy") -> None:
    """Show that Argo CD has just applied the release, in whose pod this container runs."""
    name = application_name(*release.split("/"))
    now = START_NS + int(stage.seconds * SECOND_NS)
    stage.cluster.states[name] = replace(stage.cluster.states[name], applied_ns=now, health=health)
    stage.cluster.running[release] = [PodState("cloud-0", "relay-1", release, containers=(container,))]


def ready(stage: Stage, key: str) -> tuple[str, str, str]:
    conditions = stage.tasks.objects[key]["status"]["conditions"]
    (one,) = (each for each in conditions if each["type"] == "Ready")
    return one["status"], one["reason"], one["message"]


def asked(stage: Stage) -> tuple[str, str]:
    """A task that waits for Argo CD, and its service's release."""
    key = stage.ask()
    stage.go()
    stage.cluster.settle(stage.releases())
    return key, service(stage, key)


def test_changed_settings_are_ready_after_two_probes(stage: Stage) -> None:
    """They were at once, and 10 s later never again: whoever waited had been told that they are."""
    key, release = asked(stage)
    applied(stage, release, OLD)
    stage.go(wake=APPLICATIONS)
    status, reason, message = ready(stage, key)
    assert (status, reason) == ("False", "Progressing")
    assert message == f"{release}: its settings were changed; it is ready when two probes have found them at work"
    assert stage.manager._pause() <= PROBED_NS / SECOND_NS, "it is looked at again by itself"
    stage.seconds += PROBED_NS / SECOND_NS
    stage.go(wake=APPLICATIONS)
    assert ready(stage, key)[:2] == ("True", "Observed")
    applied(stage, release, OLD)
    stage.go(wake=APPLICATIONS)
    assert ready(stage, key)[:2] == ("True", "Observed"), "the same plan once more"


@pytest.mark.parametrize(
    "container",
    [
        replace(OLD, started_ns=START_NS + SECOND_NS),
        replace(OLD, probed=False),
        replace(OLD, started_ns=None),
    ],
    ids=["a new one", "nobody asks it", "not running"],
)
def test_nothing_waits_where_no_probe_says_more(stage: Stage, container: ContainerState) -> None:
    key, release = asked(stage)
    applied(stage, release, container)
    stage.go(wake=APPLICATIONS)
    assert ready(stage, key)[:2] == ("True", "Observed")


def test_bridges_say_themselves_what_they_do_not_carry(stage: Stage) -> None:
    """So a task does not wait because a bridge that it shares got other topics."""
    key, _ = asked(stage)
    releases = stage.tasks.objects[key]["status"]["releases"]
    applied(stage, next(release for release in releases if release.endswith("/mqtt-bridge")), OLD)
    stage.go(wake=APPLICATIONS)
    assert ready(stage, key)[:2] == ("True", "Observed")


def test_refused_settings_are_told_as_such(stage: Stage) -> None:
    """It was `health is Progressing`, for good."""
    key, release = asked(stage)
    applied(stage, release, replace(OLD, ready=False), "Progressing")
    stage.go(wake=APPLICATIONS)
    assert ready(stage, key) == (
        "False",
        "Progressing",
        f"{release}: health is Progressing; pod relay-1: container relay has run since before its settings were "
        "changed and is not ready: settings refused, or not at work yet; its log says why",
    )


def test_another_machine_s_clock_holds_nothing_for_ever() -> None:
    now = [START_NS]
    proofs = SettingsProofs(lambda: now[0])
    far = START_NS + 3600 * SECOND_NS
    application = ApplicationState("relay", "20991126-204433-abcdef", applied_ns=far)
    pods = [PodState("cloud-0", "relay-1", "cloud-0/relay", containers=(OLD,))]
    assert proofs.missing("cloud-0/relay", application, pods)
    assert proofs.until_ns == START_NS + PROBED_NS
    now[0] += PROBED_NS
    assert proofs.missing("cloud-0/relay", application, pods) == ""
    proofs.begin(())
    assert proofs.missing("cloud-0/relay", application, pods), "a release that was gone is another one"


def test_argo_cd_says_when_it_applied() -> None:
    operation = {"startedAt": "1970-01-01T00:00:01Z", "finishedAt": "1970-01-01T00:00:03Z"}
    state = read_application({"metadata": {"name": "relay"}, "status": {"operationState": operation}})
    assert state.applied_ns == 3 * SECOND_NS
