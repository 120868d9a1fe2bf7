"""What is said of the components of an installation while their pods come up, and when they do not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from robotkube.cli.live.component_lines import ARGOCD, PLATFORM, SILENT_SECONDS_MAX, ComponentLines
from robotkube.cli.live.rollouts import DEPLOYMENT, JOB, STATEFUL_SET, rolled_out
from tests.stages.kubernetes.component_pods import pod, workload


class Stage:
    """Lines, with a clock that stands still."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.now = 100.0
        self.warnings: dict[str, str] = {}
        self.lines = ComponentLines(lambda line: self.said.append(line.words), self.events, lambda: self.now)

    def events(self, namespace: str, name: str) -> Sequence[Any]:
        message = self.warnings.get(f"{namespace}/{name}")
        return [{"type": "Warning", "reason": "Failed", "message": message}] if message else []

    @property
    def hanging(self) -> list[str]:
        return [line.words for line in self.lines.hanging()]


@pytest.mark.parametrize("kind", [DEPLOYMENT, STATEFUL_SET])
def test_a_component_is_ready_when_all_its_pods_are(kind: str) -> None:
    stage = Stage()
    two = {"readyReplicas": 1, "availableReplicas": 1, "replicas": 2, "updatedReplicas": 2}
    manager = workload("manager", kind=kind)
    manager["spec"]["replicas"] = 2
    for one in (workload("broker", kind=STATEFUL_SET), manager):
        stage.lines.saw(one)
    stage.now = 103.25
    stage.lines.saw({**manager, "status": {**manager["status"], **two}})
    assert stage.said == []
    stage.lines.saw(workload("broker", ready=True, kind=STATEFUL_SET))
    stage.now = 104.0
    stage.lines.saw({**manager, "status": {**manager["status"], **dict.fromkeys(two, 2)}})
    assert stage.said == ["broker: ready after 3.2 s", "manager: ready after 4.0 s"]
    assert (stage.hanging, stage.lines.is_waiting()) == ([], False)


def test_of_an_upgrade_only_what_changes_is_told() -> None:
    """The new pod comes while the old one serves; that goes afterwards."""
    stage = Stage()
    for one in (workload("broker", ready=True), workload("manager", ready=True), pod("manager-a", ready=True)):
        stage.lines.saw(one)
    changed = workload("manager", ready=True)
    changed["metadata"]["generation"] = 2
    stage.lines.saw(changed)
    stage.lines.saw(pod("manager-b", phase="Pending"))
    assert stage.hanging == ["manager is not ready: pod manager-b: Pending, containers with unready status"]
    changed = {**changed, "status": {**changed["status"], "observedGeneration": 2, "replicas": 2}}
    stage.lines.saw(changed)
    assert stage.said == []
    stage.lines.saw({**changed, "status": {**changed["status"], "replicas": 1}})
    assert stage.said == ["manager: ready after 0.0 s"]


def test_of_a_stateful_set_the_newest_pods_count() -> None:
    changing = workload("broker", ready=True, kind=STATEFUL_SET)
    assert rolled_out(changing)
    changing["status"]["updateRevision"] = "b"
    assert not rolled_out(changing)
    changing["spec"]["updateStrategy"] = {"type": "OnDelete"}
    assert rolled_out(changing)


def test_a_pod_that_goes_is_not_what_hangs() -> None:
    stage = Stage()
    stage.lines.saw(workload("manager"))
    going = pod("manager-a")
    going["metadata"]["deletionTimestamp"] = "2026-11-27T10:00:00Z"
    stage.lines.saw(going)
    stage.lines.saw(pod("manager-b"))
    stage.lines.gone(pod("manager-b"))
    assert stage.hanging == ["manager is not ready: Deployment manager: 0 of 1 pods are ready"]
    replaced = workload("manager")
    replaced["metadata"]["deletionTimestamp"] = "2026-11-27T10:00:00Z"
    stage.lines.saw(replaced)
    assert (stage.said, stage.hanging) == ([], [])


def test_a_job_is_done() -> None:
    stage = Stage()
    stage.lines.saw(workload("bootstrap", kind=JOB))
    stage.lines.saw(pod("bootstrap-x", ready=True))
    stage.now += 12
    assert stage.hanging == ["bootstrap is not ready: pod bootstrap-x: Running"]
    stage.lines.saw(workload("bootstrap", ready=True, kind=JOB))
    assert stage.said == ["bootstrap: done after 12.0 s"]


def test_a_job_that_tried_twice_is_done_although_a_pod_of_it_failed() -> None:
    stage = Stage()
    stage.lines.saw(workload("bootstrap", kind=JOB))
    stage.lines.saw(pod("bootstrap-x", phase="Failed"))
    stage.lines.saw(pod("bootstrap-y", phase="Succeeded"))
    stage.lines.saw(workload("bootstrap", ready=True, kind=JOB))
    assert (stage.said, stage.hanging) == (["bootstrap: done after 0.0 s"], [])


@pytest.mark.parametrize(
    ("hook", "waits"), [("test", False), ("pre-delete", False), ("post-install,post-upgrade", True), ("", True)]
)
def test_only_jobs_of_the_installation_count(hook: str, waits: bool) -> None:
    stage = Stage()
    job = workload("some", kind=JOB)
    job["metadata"]["annotations"] = {"helm.sh/hook": hook}
    stage.lines.saw(job)
    assert stage.lines.is_waiting() is waits


def test_without_a_pod_it_is_said_what_speaks_against_one() -> None:
    stage = Stage()
    gate = workload("gate")
    failure = {"type": "ReplicaFailure", "status": "True", "reason": "FailedCreate", "message": "violates PodSecurity"}
    gate["status"]["conditions"] = [failure]
    failed = workload("gate-key", kind=JOB)
    failed["status"]["conditions"] = [
        {"type": "Failed", "status": "True", "reason": "BackoffLimitExceeded", "message": "it has reached its limit"}
    ]
    for one in (gate, workload("forge", kind=STATEFUL_SET), failed):
        stage.lines.saw(one)
    stage.warnings["robotkube/forge"] = "exceeded quota"
    assert stage.hanging == [
        "forge is not ready: StatefulSet forge: 0 of 1 pods are ready; event Failed: exceeded quota",
        "gate is not ready: Deployment gate: 0 of 1 pods are ready; Deployment gate: FailedCreate: violates "
        "PodSecurity",
        "gate-key is not ready: Job gate-key failed: BackoffLimitExceeded: it has reached its limit",
    ]


def test_what_hangs_is_said_with_its_events_once_for_each_reason() -> None:
    stage = Stage()
    waits = {"waiting": {"reason": "ImagePullBackOff", "message": "no such image"}}
    stage.lines.saw(workload("forge", kind=STATEFUL_SET))
    stage.lines.saw(
        pod("forge-0", phase="Pending", containerStatuses=[{"name": "gitea", "ready": False, "state": waits}])
    )
    stage.warnings["robotkube/forge-0"] = "Failed to pull image"
    stage.lines.look()
    assert stage.said == []
    expected = (
        "forge is not ready: pod forge-0: container gitea waits: ImagePullBackOff: no such image; "
        "event Failed: Failed to pull image"
    )
    for _ in range(3):
        stage.now += SILENT_SECONDS_MAX
        stage.lines.look()
    assert stage.said == [expected]
    stage.warnings["robotkube/forge-0"] = "Back-off"
    stage.now += SILENT_SECONDS_MAX
    stage.lines.look()
    assert stage.said == [expected, expected.replace("Failed to pull image", "Back-off")]


def test_nothing_is_said_to_hang_while_others_become_ready() -> None:
    stage = Stage()
    stage.lines.saw(workload("forge"))
    for number in range(3):
        stage.now += SILENT_SECONDS_MAX - 1
        stage.lines.saw(workload(f"c{number}"))
        stage.lines.saw(workload(f"c{number}", ready=True))
        stage.lines.look()
    assert [line for line in stage.said if "not ready" in line] == []


def test_pods_of_the_same_name_elsewhere_are_anothers() -> None:
    stage = Stage()
    stage.lines.saw(workload("gate", namespace="robotkube-gate"))
    stage.lines.saw(pod("gate-0", namespace="vehicle-00"))
    stage.lines.saw(workload("argocd-server", ready=True, namespace="argocd", part=ARGOCD))
    assert stage.hanging == ["gate is not ready: Deployment gate: 0 of 1 pods are ready"]
    assert [stage.lines.components(part) for part in (PLATFORM, ARGOCD)] == [1, 1]
