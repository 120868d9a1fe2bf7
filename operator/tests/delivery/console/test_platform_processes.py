"""Gate, forge and Argo CD's controller: one sentence of each that is away, and none of what was never there."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.delivery.console.adapters.cluster_watches import read_process_pod
from robotkube.delivery.console.core.platform_processes import (
    ADVICE,
    CARRIES,
    CONTROLLER,
    FORGE,
    GATE,
    NAMES,
    PlatformProcesses,
    ProcessPod,
)
from tests.delivery.console import documents as given


def processes() -> PlatformProcesses:
    return PlatformProcesses("robotkube", "argocd", "robotkube-gate")


def ready(process: str, namespace: str) -> ProcessPod:
    return ProcessPod(process, namespace, True, "it is Running")


def told(of: PlatformProcesses, *pods: ProcessPod) -> dict[str, str]:
    return {presence.process: presence.problem for presence in of.presences(pods)}


ALL = (ready(GATE, "robotkube-gate"), ready(FORGE, "robotkube"), ready(CONTROLLER, "argocd"))


def test_what_is_ready_is_well() -> None:
    assert told(processes(), *ALL) == {GATE: "", FORGE: "", CONTROLLER: ""}


def test_who_was_seen_once_is_missed_and_the_gate_always_is() -> None:
    of = processes()
    assert told(of) == {GATE: "There is no pod of it."}
    told(of, *ALL)
    assert told(of) == dict.fromkeys(NAMES, "There is no pod of it.")


def test_a_pod_that_is_not_ready_says_why_and_one_that_is_ready_is_enough() -> None:
    broken = ProcessPod(FORGE, "robotkube", False, "container forge: CrashLoopBackOff")
    assert told(processes(), broken)[FORGE] == ("Its pod in robotkube is not ready: container forge: CrashLoopBackOff.")
    assert told(processes(), broken, ready(FORGE, "robotkube"))[FORGE] == ""


@pytest.mark.parametrize("namespace", ["cloud-0", "robotkube-suite-0", "robotkube"])
def test_a_pod_elsewhere_is_none_of_them_whatever_its_label_says(namespace: str) -> None:
    """Such as that of a chart which is tried in a test namespace, and chooses its labels."""
    pretended = (ready(GATE, namespace), ready(FORGE, "cloud-0"), ready(CONTROLLER, namespace))
    assert told(processes(), *pretended) == {GATE: "There is no pod of it."}


def test_no_gate_is_missed_where_nobody_knows_its_namespace() -> None:
    assert told(PlatformProcesses("robotkube", "argocd", "")) == {}


def test_a_pod_is_read_by_its_label() -> None:
    def labelled(**more: Any) -> dict[str, Any]:
        pod = given.pod(**more)
        pod["metadata"]["labels"]["app.kubernetes.io/name"] = GATE
        return pod

    assert read_process_pod(labelled()) == ProcessPod(GATE, "cloud-0", True, "it is Running")
    assert not read_process_pod(labelled(ready=False)).ready
    leaving = labelled()
    leaving["metadata"]["deletionTimestamp"] = given.TIME
    assert read_process_pod(leaving) == ProcessPod(GATE, "cloud-0", False, "it is being removed")


def test_each_has_what_to_do_and_what_stands_still() -> None:
    assert set(NAMES) == set(ADVICE) == set(CARRIES)
