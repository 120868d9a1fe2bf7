"""Who reaches whom on the running cluster: each pod of the platform, of agents and of Argo CD tries every other one,
the API server and the name service, from within its own network namespace. Where policies are not enforced everybody
reaches everybody."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

from ci.cluster.embedded.network.pod_links import RESULTS, read_link
from ci.cluster.embedded.network_policies import enforcement
from ci.cluster.embedded.network_policies.controller import NAMESPACES, POLICIES, known_pod
from ci.machine import network_policies
from ci.machine.network_policies import OFF
from robotkube.foundation.kubernetes.core.network_policies import NetworkPeer, NetworkPolicy, may_connect, read_policy
from tests.stages.network.namespaces import reached
from tests.stages.platform.running_platform import Platform, eventually

PORTS = (22, 1883, 3000, 6379, 7000, 8080, 8081, 8083, 8883, 10250, 27017, 27018)
HOST_PORTS = (53, 6443)
LEAST_SECONDS, MOST_SECONDS = 2.0, 30.0
PARALLEL = 8
OWN_NAMESPACE = Path("/proc/self/ns/net")
Reach = tuple[str, str, int]  # who, whom, TCP port


@dataclass(frozen=True)
class Attached:
    """A running pod and the way into its network namespace."""

    peer: NetworkPeer
    namespace: Path

    @property
    def key(self) -> str:
        return f"{self.peer.namespace}/{self.peer.name}"


def attached(platform: Platform) -> dict[str, Attached]:
    """The pods that have an address of their node now, by key."""
    api = platform.provider.api()
    folders = platform.provider.folders
    labels = {one["metadata"]["name"]: one["metadata"].get("labels") or {} for one in api.get(NAMESPACES)["items"]}
    pods = dict(known_pod(one) for one in api.get("/api/v1/pods")["items"])
    namespaces: dict[str, Attached] = {}
    for node, holder in enforcement.holders(folders).items():
        for path in (folders.node(node) / "cni-state" / RESULTS).glob("*"):  # no folder before a node's first pod
            document = json.loads(path.read_text(encoding="utf-8"))
            link = read_link(document)
            if link.uid in pods:
                pod = pods[link.uid]
                namespace = labels[link.namespace]
                peer = NetworkPeer(link.name, link.address, link.namespace, pod.labels, namespace, pod.ports)
                one = Attached(peer, Path(f"/proc/{holder.pid}/root{document['netns']}"))
                namespaces[one.key] = one
    return namespaces


@pytest.fixture(scope="module")
def pods(platform: Platform) -> Mapping[str, Attached]:
    """Once everything runs that main asks for, so that nobody comes or goes meanwhile."""
    eventually("everything that main asks for runs", platform.settled)
    return attached(platform)


@pytest.fixture(scope="module")
def policies(platform: Platform) -> list[NetworkPolicy]:
    """Those at work."""
    if network_policies.choice() == OFF:
        return []
    return [read_policy(one) for one in platform.provider.api().get(POLICIES)["items"]]


def host(platform: Platform) -> NetworkPeer:
    return NetworkPeer("host", str(platform.provider.plan.gateway))


def found(source: str, namespace: Path, others: Iterable[NetworkPeer], wanted: set[Reach]) -> set[Reach]:
    """Whom somebody reaches."""
    targets = {
        (one.address, port): (source, name(one), port)
        for one in others
        for port in (PORTS if one.namespace else HOST_PORTS)
    }
    asked = {target for target, reach in targets.items() if reach in wanted}
    return {targets[one] for one in reached(namespace, targets, asked, LEAST_SECONDS, MOST_SECONDS)}


def name(peer: NetworkPeer) -> str:
    return f"{peer.namespace}/{peer.name}" if peer.namespace else peer.name


def said(policies: list[NetworkPolicy], source: NetworkPeer, others: Iterable[NetworkPeer]) -> set[Reach]:
    """Whom the policies let somebody reach."""
    return {
        (name(source), name(one), port)
        for one in others
        for port in (PORTS if one.namespace else HOST_PORTS)
        if may_connect(policies, source, one, "TCP", port).allowed
    }


def test_every_pod_reaches_whom_the_policies_say_and_nobody_else(
    platform: Platform, pods: Mapping[str, Attached], policies: list[NetworkPolicy]
) -> None:
    assert {key.split("/")[0] for key in pods} >= {"robotkube", "robotkube-gate", "argocd", "cloud-0", "vehicle-00"}

    def difference(own: Attached) -> set[Reach]:
        others = [host(platform), *(pod.peer for pod in pods.values() if pod.key != own.key)]
        wanted = said(policies, own.peer, others)
        return found(own.key, own.namespace, others, wanted) ^ wanted

    with ThreadPoolExecutor(PARALLEL) as pool:
        assert [one for one in pool.map(difference, pods.values()) if one] == []


def test_the_machine_reaches_whom_the_policies_say_and_nobody_else(
    platform: Platform, pods: Mapping[str, Attached], policies: list[NetworkPolicy]
) -> None:
    others = [pod.peer for pod in pods.values()]
    wanted = said(policies, host(platform), others)
    assert found("host", OWN_NAMESPACE, others, wanted) == wanted


def test_a_vehicle_reaches_its_own_and_the_broker_alone(
    platform: Platform, pods: Mapping[str, Attached], policies: list[NetworkPolicy]
) -> None:
    """Written down by hand: what it reached before is what an attacker wants."""
    if not policies:
        return
    [own] = [one for key, one in pods.items() if key.startswith("vehicle-00/mqtt-bridge")]
    [broker] = [key for key in pods if key.startswith("robotkube/broker")]
    others = [host(platform), *(pod.peer for pod in pods.values() if pod.peer.namespace != "vehicle-00")]
    wanted = {(own.key, broker, 8883), (own.key, "host", 53), (own.key, "host", 6443)}
    assert found(own.key, own.namespace, others, wanted) == wanted


def test_the_status_says_whether_policies_are_enforced(platform: Platform, policies: list[NetworkPolicy]) -> None:
    line = platform.provider.status().splitlines()[-1]
    nodes = len(platform.provider.nodes())
    if policies:
        assert line == f"network policies: {len(policies)} enforced on {nodes} nodes"
    else:
        assert line.startswith("network policies: not enforced")
