"""Answers of probes in pods' statuses: what is read, which losses are noted, and what they say of a release."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.manager.adapters.pod_states import placed, read_pod
from robotkube.delivery.manager.core.observation import ContainerState, PodState
from robotkube.delivery.manager.core.updates.cluster_health import HEALTHY, PROGRESSING, ClusterHealth, ReleaseHealth
from robotkube.delivery.manager.core.updates.probe_answers import (
    SAID_NO,
    ProbeFault,
    ProbeLoss,
    ProbeLosses,
    losses_between,
    probe_answers,
)
from robotkube.delivery.manager.loops.updates.first_runs import FirstHealthy
from robotkube.foundation.documents.core.times import time_ns
from tests.stages.delivery.manager.update_fleet import release

AT = "2026-11-21T10:00:00Z"
AT_NS = time_ns(AT)
KEY = "vehicle-00/detection"


def document(last: Mapping[str, Any] | None = None, ready: bool = True) -> dict[str, Any]:
    status = {"name": "app", "ready": ready, "restartCount": 2, "imageID": "a@sha256:1", "lastState": last or {}}
    condition = {"type": "ContainersReady", "status": str(ready), "lastTransitionTime": AT}
    return {
        "metadata": {
            "namespace": "vehicle-00",
            "name": "detection-1",
            "uid": "u",
            "labels": {"app.kubernetes.io/instance": "detection"},
        },
        "spec": {"nodeName": "n", "containers": [{"name": "app", "readinessProbe": {}}, {"name": "helper"}]},
        "status": {"conditions": [condition], "containerStatuses": [status, {"name": "helper", "ready": True}]},
    }


def test_a_pod_is_read_with_what_its_probes_say() -> None:
    ended = {"terminated": {"finishedAt": AT, "reason": "Error", "exitCode": 1}}
    pod = read_pod(document(ended, ready=False))
    app = ContainerState("app", True, False, 2, AT_NS, "Error, exit code 1")
    assert pod.containers == (app, ContainerState("helper", False, True))
    assert (pod.uid, pod.release, pod.ready_since, pod.unready_since) == ("u", KEY, None, AT_NS)
    assert read_pod(document()).ready_since == AT_NS
    assert placed(read_pod(document(ready=False))) == placed(read_pod(document()))
    assert placed(pod) != placed(read_pod(document())), "what it ended by is told at once"


def test_a_container_that_ended_is_not_said_to_have_answered_no() -> None:
    now = document(ready=False)
    now["status"]["containerStatuses"][0]["state"] = {
        "terminated": {"finishedAt": AT, "reason": "Completed", "exitCode": 0}
    }
    [loss] = losses_between(read_pod(document()), read_pod(now), 1)
    assert (loss.container, loss.time_ns, loss.text) == ("app", AT_NS, "ended (Completed, exit code 0)")
    [loss] = losses_between(read_pod(document()), read_pod(document(ready=False)), 1)
    assert loss.text == SAID_NO


@pytest.mark.parametrize("reason", ["Unknown", "ContainerStatusUnknown"])
def test_what_ended_with_its_machine_did_not_end_by_itself(reason: str) -> None:
    ended = {"terminated": {"finishedAt": AT, "reason": reason, "exitCode": 255}}
    assert read_pod(document(ended)).containers[0].ended_ns is None


APP = ContainerState("app", True, True)
POD = PodState("vehicle-00", "detection-1", KEY, uid="u", containers=(APP,), ready_since=5)
UNREADY = replace(POD, containers=(replace(APP, ready=False),), ready_since=None, unready_since=7)


@pytest.mark.parametrize(
    ("before", "now", "at"),
    [
        (POD, UNREADY, 7),
        (POD, replace(UNREADY, unready_since=None), 99),
        (POD, replace(POD, ready_since=9), 9),
        (POD, replace(UNREADY, deleting=True), None),
        (POD, replace(UNREADY, uid="another"), None),
        (POD, None, None),
        (None, UNREADY, None),
        (UNREADY, POD, None),
        (UNREADY, replace(UNREADY, node="n"), None),
        (replace(POD, containers=(APP, APP)), replace(POD, containers=(APP, APP), ready_since=9), None),
    ],
)
def test_a_probe_that_said_yes_and_says_no_is_noted_also_when_it_was_for_a_moment(
    before: PodState | None, now: PodState | None, at: int | None
) -> None:
    losses = ProbeLosses()
    assert losses.note(before, now, 99) is (at is not None)
    assert losses.all() == ((ProbeLoss(KEY, "u", "app", at),) if at is not None else ())


def test_losses_count_for_the_pods_that_are_there_and_restarts_are_read_from_them() -> None:
    restarted = ContainerState("app", True, True, 1, 8, "Error, exit code 1")
    helper = ContainerState("helper", False, False, 1, 8, "Error, exit code 1")
    pods = [replace(POD, containers=(restarted, helper)), replace(POD, uid="old", deleting=True)]
    losses = [ProbeLoss(KEY, "u", "app", 6), ProbeLoss(KEY, "old", "app", 6), ProbeLoss(KEY, "u", "gone", 6)]
    answers = probe_answers(pods, losses)
    ended = ProbeFault("app", 8, "ended (Error, exit code 1) and was started again", True)
    assert answers.containers == {"app"}
    assert answers.faults == (ended, ProbeFault("app", 6, SAID_NO))


def test_a_release_was_first_healthy_until_its_plan_changes_or_its_agent_was_away() -> None:
    one = release("vehicle-00")
    first = FirstHealthy()

    def seen(state: str, since: int | None, now: int, plan: str = "", online: int = 0) -> int | None:
        cluster = ClusterHealth({one.key: ReleaseHealth(state, since)}, {"vehicle-00": online})
        return first.note([replace(one, plan=plan)], cluster, now).health[one.key].first_ns

    assert seen(PROGRESSING, 1, 2) is None
    assert seen(HEALTHY, None, 3) == 3
    assert seen(PROGRESSING, 4, 5) == 3
    assert seen(HEALTHY, 6, 7) == 3
    assert seen(HEALTHY, 6, 8, plan="another") == 6
    assert seen(PROGRESSING, 8, 8, plan="another", online=8) is None
