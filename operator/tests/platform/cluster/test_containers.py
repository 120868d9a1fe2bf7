"""Containers beside the kubelets of the running platform: those of all tests before were everybody's own, and two that
somebody starts by a machine's runtime are named within 15 s, as long as they run."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from ci.cluster.embedded.containers.reports import PROCESS
from ci.cluster.embedded.host.processes import recorded
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.nodes import node_processes
from ci.images import image_lock
from tests.stages.kubernetes.lone_node import remove_groups_of_namespaces
from tests.stages.platform.running_platform import Platform, eventually

NODE, FOREIGN = "vehicle-02", "miner"
STARTED = "foreign"
NAMED_SECONDS_MAX = 15
NAMESPACES = ("default", "k8s.io")  # the second is that of kubelets

Ctr = Callable[..., str]


@pytest.fixture
def ctr(platform: Platform) -> Iterator[Ctr]:
    """`ctr` on a machine's own socket; what a test started is removed."""
    [holder] = recorded(ClusterFolders(platform.name), f"{NODE}.node")
    own = [str(platform.provider.binaries / "ctr"), "--address", str(node_processes.socket_of(holder)), "--namespace"]

    def run(*words: str, check: bool = True) -> str:
        return subprocess.run([*own, *words], check=check, capture_output=True, text=True, timeout=60).stdout

    yield run
    for namespace in NAMESPACES:
        run(namespace, "tasks", "delete", "--force", FOREIGN, check=False)
        run(namespace, "containers", "delete", FOREIGN, check=False)
    remove_groups_of_namespaces()


def inspection(platform: Platform, node: str) -> dict[str, Any]:
    """What stands of a machine in the cluster; the remover's condition stays where it has been."""
    status = platform.get("-n", "robotkube", "inspections", f"machine.{node}")["status"]
    conditions = {one["type"]: one["status"] for one in status["conditions"] if one["type"] != "Removed"}
    return {**status, "conditions": conditions}


def strangers(platform: Platform) -> list[str]:
    return sorted(one["name"] for one in inspection(platform, NODE)["strangers"])


def test_what_the_platform_ran_so_far_was_known_on_every_node(platform: Platform) -> None:
    """Pods of all tests before came, went, crashed, and were moved."""
    for node in platform.provider.nodes():
        assert inspection(platform, node.name)["conditions"] == {"Seen": "True", "Clean": "True"}
    log = (ClusterFolders(platform.name).log / f"{PROCESS}.log").read_text(encoding="utf-8")
    own = f"container {STARTED} of pod"  # by test_inspection
    assert [line for line in log.splitlines() if "stranger appeared" in line and own not in line] == []
    assert (
        f"containers: none beside the kubelets of {len(platform.provider.nodes())} nodes" in platform.provider.status()
    )


def test_what_somebody_starts_beside_a_kubelet_is_named_until_it_ends(platform: Platform, ctr: Ctr) -> None:
    pause = next(one for one in image_lock.read_lock(image_lock.lock_file()) if one.name == image_lock.SANDBOX)
    for namespace in NAMESPACES:
        imported = ("images", "import", "--local", "--digests", "--base-name", pause.repository, str(pause.archive))
        ctr(namespace, *imported)
        ctr(namespace, "run", "--detach", "--null-io", pause.reference, FOREIGN)
    wanted = [f"{namespace}/{FOREIGN}" for namespace in NAMESPACES]
    eventually("both are named", lambda: strangers(platform) == wanted, NAMED_SECONDS_MAX)
    assert inspection(platform, NODE)["conditions"] == {"Seen": "True", "Clean": "False"}
    said = platform.provider.status()
    assert "containers: 2 STARTED BESIDE THE KUBELETS" in said
    assert f"container default/{FOREIGN} on node {NODE}" in said
    events = platform.get("-n", "robotkube", "events.events.k8s.io")["items"]
    assert [event for event in events if event["reason"] == "BesideTheKubelet" and FOREIGN in event.get("note", "")]
    for namespace in NAMESPACES:
        ctr(namespace, "tasks", "kill", "--signal", "SIGKILL", FOREIGN)
        eventually("it has ended", lambda namespace=namespace: "STOPPED" in ctr(namespace, "tasks", "list"))
        ctr(namespace, "tasks", "delete", FOREIGN)
    eventually("none is there any more", lambda: strangers(platform) == [], NAMED_SECONDS_MAX)
