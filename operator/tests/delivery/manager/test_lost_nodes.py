"""What is read of Nodes, and pods that a dead node keeps."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.delivery.manager.adapters.kubernetes_cluster import read_node
from robotkube.delivery.manager.core.observation import ApplicationState, PodState, judge_removed
from robotkube.delivery.manager.core.placement.capacity import Resources

AT = "2026-11-21T10:00:00Z"
AT_NS = 1_795_255_200_000_000_000
GOING = ApplicationState("edge-0-recorder", deleting=True)


def node(status: str = "True", **allocatable: str) -> dict[str, Any]:
    labels = {
        "robotkube.io/agent": "edge-0",
        "robotkube.io/role": "edge",
        "robotkube.io/capability.gpu": "true",
        "kubernetes.io/os": "linux",
        "kubernetes.io/arch": "arm64",
    }
    ready = {"type": "Ready", "status": status, "lastTransitionTime": AT}
    full = {"conditions": [{"type": "DiskPressure", "status": "False"}, ready], "allocatable": allocatable}
    return {"metadata": {"name": "n", "labels": labels}, "status": full}


@pytest.mark.parametrize(
    ("status", "ready", "not_ready", "silent"),
    [("True", AT_NS, None, None), ("False", None, AT_NS, None), ("Unknown", None, AT_NS, AT_NS)],
)
def test_since_when_a_node_is_as_it_is(status: str, ready: int, not_ready: int, silent: int) -> None:
    state = read_node(node(status))
    assert (state.ready_since, state.not_ready_since, state.silent_since) == (ready, not_ready, silent)
    assert state.ready is (status == "True")
    assert state.silent_seconds(AT_NS + 5_500_000_000) == (5.5 if silent else 0.0)
    assert state.silent_seconds(AT_NS - 1) == 0.0


def test_room_and_platform_of_a_node() -> None:
    state = read_node(node(cpu="3920m", memory="16316412Ki", pods="110"))
    assert state.allocatable == Resources(3920, 16316412 * 1024)
    assert state.platform == "linux/arm64"
    assert read_node(node(cpu="4", memory="8000000000")).allocatable == Resources(4000, 8_000_000_000)
    young = read_node({"metadata": {"name": "n"}})
    assert (young.allocatable, young.platform, young.ready, young.not_ready_since) == (None, "", False, None)


def pod(name: str, **more: Any) -> PodState:
    return PodState("edge-0", name, "edge-0/recorder", "n", **{"deleting": True, **more})


def test_a_deleted_pod_on_a_silent_node_holds_nobody_up() -> None:
    dead, alive = pod("dead", node_silent_seconds=41.0), pod("alive", node_silent_seconds=39.0)
    verdict = judge_removed(None, [dead])
    assert (verdict.done, verdict.unreachable) == (True, ("edge-0/dead",))
    assert verdict.message == "pod dead is out of reach on silent node n"
    waiting = judge_removed(None, [dead, alive])
    assert (waiting.done, waiting.unreachable, waiting.message) == (False, (), "pods still exist: alive")
    running = judge_removed(None, [pod("runs", deleting=False, node_silent_seconds=99.0)])
    assert (running.done, running.message) == (False, "pods still exist: runs")


def test_an_application_that_waits_for_such_pods_only_counts_as_gone() -> None:
    dead = pod("dead", node_silent_seconds=41.0)
    verdict = judge_removed(GOING, [dead])
    assert (verdict.annotated, verdict.synced, verdict.done) == (True, True, True)
    assert verdict.unreachable == ("edge-0/dead",)
    assert judge_removed(GOING, [dead, pod("alive")]).message == "its Argo CD Application is being deleted"
    assert not judge_removed(GOING, []).done
    stays = ApplicationState("edge-0-recorder")
    assert judge_removed(stays, [dead]).message == "its Argo CD Application still exists"


def test_it_is_closed_when_the_node_was_deleted_or_is_back() -> None:
    verdict = judge_removed(None, [pod("dead", node_gone=True)])
    assert (verdict.done, verdict.unreachable, verdict.message) == (True, (), "")
    back = judge_removed(None, [pod("dead", node_silent_seconds=0.0)])  # the kubelet will end it
    assert (back.done, back.unreachable) == (False, ())
    assert judge_removed(None, []).done
