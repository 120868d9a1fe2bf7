"""`python -m ci.cluster.embedded.network_policies.controller`: keeps each node's nftables rules to what the cluster's
NetworkPolicies say.

A process of the host. Addresses come from the nodes (`pod_links`), labels and policies from the API server. A change of
either is followed at once; while the API server is away the rules stay as they are, and new pods are cut off.
"""

from __future__ import annotations

import argparse
import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from kubernetes.client import ApiClient

from ci.cluster.embedded.host.processes import Process
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.pod_links import RESULTS, NodeLinks, PodLink
from ci.cluster.embedded.network_policies import enforcement
from ci.cluster.embedded.network_policies.enforcement import REPORT_SECONDS, PolicyReport
from ci.cluster.embedded.network_policies.nftables_rules import AttachedPod, Rulebook
from ci.errors import SetUpError
from robotkube.errors import InputError, RobotKubeError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.foundation.kubernetes.adapters.client import ResourceWatch, api_client, call
from robotkube.foundation.kubernetes.core.network_policies import NetworkPeer, NetworkPolicy, read_policy
from robotkube.foundation.kubernetes.core.objects import object_key

POLL_SECONDS = 0.05  # between looks at the addresses that nodes gave out; a pod's first process comes later
AGAIN_SECONDS = 0.5  # after a failure
NODES_SECONDS = 1.0  # between looks for nodes that joined
POLICIES, NAMESPACES, PODS = ("/apis/networking.k8s.io/v1/networkpolicies", "/api/v1/namespaces", "/api/v1/pods")

Object = Mapping[str, Any]
Links = Mapping[str, frozenset[PodLink]]

log = logging.getLogger("robotkube.network-policies")


@dataclass(frozen=True)
class KnownPod:
    """A pod as the API server has it: labels, and ports by (protocol, name)."""

    key: str
    labels: Mapping[str, str]
    ports: Mapping[tuple[str, str], int]


@dataclass(frozen=True)
class Observed:
    """Policies, namespaces (labels by name) and pods (by uid) of one moment: policies and namespaces are not older than
    any of the pods, so a pod is never known without the policies that were there before it."""

    policies: Sequence[NetworkPolicy] = ()
    namespaces: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    pods: Mapping[str, KnownPod] = field(default_factory=dict)


def known_pod(document: Object) -> tuple[str, KnownPod]:
    """A pod's uid, and what is known of it. A port's name that two containers use is the first one's."""
    ports: dict[tuple[str, str], int] = {}
    spec = document.get("spec") or {}
    sidecars = [one for one in spec.get("initContainers") or () if one.get("restartPolicy") == "Always"]
    for container in [*spec.get("containers", ()), *sidecars]:
        for port in container.get("ports") or ():
            if port.get("name"):
                ports.setdefault((port.get("protocol") or "TCP", port["name"]), port["containerPort"])
    metadata = document["metadata"]
    return metadata["uid"], KnownPod(object_key(document), metadata.get("labels") or {}, ports)


def policy(document: Object, complaints: set[str]) -> NetworkPolicy:
    """A policy; one that is not understood denies everything to all pods of its namespace, and adds a complaint."""
    try:
        return read_policy(document)
    except InputError as error:
        complaints.add(str(error))
        metadata = document["metadata"]
        return NetworkPolicy(str(metadata["namespace"]), str(metadata["name"]), (), (), ())


class PolicyController:
    """The rules of the nodes follow what is observed. `links`: what each node gave out; `apply` replaces the rules of a
    node; what they raise is raised, and they are asked again in the next step."""

    def __init__(
        self, links: Callable[[], Links], observe: Callable[[], Observed], apply: Callable[[str, str], None]
    ) -> None:
        self._links = links
        self._observe = observe
        self._apply = apply
        self._followed: Links | None = None
        self._applied: dict[str, str] = {}
        self.policies = 0

    @property
    def nodes(self) -> int:
        """The number of nodes that have rules."""
        return len(self._applied)

    def step(self, changed: bool) -> None:
        """Follow when an object has `changed`, a node gave out an address or took one back, or the last step failed. A
        node whose rules cannot be replaced keeps no other one from its own; the first such error is raised at the end.
        """
        links = self._links()
        if not changed and links == self._followed:
            return
        before, self._followed = self._followed, None
        observed = self._observe()
        texts = rules(observed, links)
        self._applied = {node: text for node, text in self._applied.items() if node in texts}
        order = sorted(texts, key=lambda node: (_has_new(node, links, before), node))
        failures = [error for node in order if (error := self._replaced(node, texts[node]))]
        if failures:
            raise failures[0]
        self.policies = len(observed.policies)
        self._followed = links

    def _replaced(self, node: str, text: str) -> SetUpError | None:
        """What stands against the rules of a node; nothing when it has them."""
        if self._applied.get(node) == text:
            return None
        try:
            self._apply(node, text)
        except SetUpError as error:
            return error
        self._applied[node] = text
        return None


def _has_new(node: str, links: Links, before: Links | None) -> bool:
    """Return whether a node has new pods: it comes last, so that the others let them in before they may come out."""
    return bool(links[node] - (before or {}).get(node, frozenset()))


def rules(observed: Observed, links: Links) -> dict[str, str]:
    """The rules of each node. A link whose pod, or its namespace, is not known gives no rules: it is cut off."""
    attached = {
        node: [AttachedPod(link.port, peer) for link in own if (peer := _peer(link, observed))]
        for node, own in links.items()
    }
    book = Rulebook(observed.policies, [one.pod for own in attached.values() for one in own])
    return {node: book.node(own) for node, own in attached.items()}


def _peer(link: PodLink, observed: Observed) -> NetworkPeer | None:
    pod, namespace = (observed.pods.get(link.uid), observed.namespaces.get(link.namespace))
    if pod is None or namespace is None or pod.key != f"{link.namespace}/{link.name}":
        return None
    return NetworkPeer(link.name, link.address, link.namespace, pod.labels, namespace, pod.ports)


class RulesOfNodes:
    """The nodes of a cluster on this machine: what they gave out, and their rules."""

    def __init__(self, folders: ClusterFolders, clock: Callable[[], float] = time.monotonic) -> None:
        self._folders = folders
        self._clock = clock
        self._asked = float("-inf")
        self._holders: dict[str, Process] = {}
        self._links: dict[str, NodeLinks] = {}

    def links(self) -> Links:
        """What each node gave out; nodes that joined are known within NODES_SECONDS."""
        if self._clock() >= self._asked + NODES_SECONDS:
            self._asked = self._clock()
            self._holders = enforcement.holders(self._folders)
        for node in self._holders:
            self._links.setdefault(node, NodeLinks(self._folders.node(node) / "cni-state" / RESULTS))
        return {node: self._links[node].read() for node in self._holders}

    def apply(self, node: str, text: str) -> None:
        """Replace a node's rules."""
        enforcement.apply(self._holders[node], text)


class ClusterObjects:
    """Policies, namespaces and pods of an API server; `changed` is set when one of them is another than before."""

    def __init__(self, api: ApiClient, changed: threading.Event) -> None:
        def watch(path: str, reduce: Callable[[Object], Any]) -> ResourceWatch:
            return ResourceWatch(api, path, "", reduce, lambda *_: changed.set())

        self._api = api
        self._complaints: set[str] = set()
        self._pods = watch(PODS, known_pod)
        labels = watch(NAMESPACES, lambda item: item["metadata"].get("labels") or {})
        self._others = (watch(POLICIES, lambda item: item["spec"]), labels)

    def start(self) -> None:
        """Begin to watch."""
        for watch in (self._pods, *self._others):
            watch.start()

    def stop(self) -> None:
        """End the watches."""
        for watch in (self._pods, *self._others):
            watch.stop()

    def observe(self) -> Observed:
        """What is there now; UnavailableError or InputError when it cannot be said."""
        if not self._pods.synced.is_set():
            raise UnavailableError(self._pods.complaint)
        pods = dict(self._pods.values().values())  # before policies and namespaces
        namespaces = {one["metadata"]["name"]: one["metadata"].get("labels") or {} for one in self._items(NAMESPACES)}
        complaints: set[str] = set()
        policies = [policy(one, complaints) for one in self._items(POLICIES)]
        for complaint in sorted(complaints - self._complaints):
            log.warning("network policies: taken as one that denies everything: %s", complaint)
        self._complaints = complaints
        return Observed(policies, namespaces, pods)

    def _items(self, path: str) -> Sequence[Object]:
        return list(read_json_shortened(call(self._api, "GET", path).data)["items"])


def reconcile(
    controller: PolicyController,
    wait: Callable[[float], bool],
    report: Callable[[PolicyReport], None],
    clock: Callable[[], float],
) -> None:
    """Step for ever. `wait` returns after so many seconds, or at once (True) when an object has changed. Now and then
    everything is read again, whatever was heard of. What keeps it from reconciling is logged when it comes and when it
    is another thing, and reported."""
    changed = True
    problem = ""
    reported = float("-inf")
    while True:
        before = (problem, controller.policies, controller.nodes)
        due = not 0 <= clock() - reported < REPORT_SECONDS
        try:
            controller.step(changed or due)
            problem = ""
        except (RobotKubeError, SetUpError) as error:
            if str(error) != problem:
                log.warning("network policies: the rules stay as they are: %s", error)
            problem = str(error)
        if due or before != (problem, controller.policies, controller.nodes):
            reported = clock()
            report(PolicyReport(controller.policies, controller.nodes, reported, problem))
        changed = wait(AGAIN_SECONDS if problem else POLL_SECONDS)


def woken(changed: threading.Event, seconds: float) -> bool:
    """Wait until something has changed, at most so long. What changes after that is for the next time."""
    if not changed.wait(seconds):
        return False
    changed.clear()  # before anything is read, so that nothing is missed
    return True


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m ci.cluster.embedded.network_policies.controller", description=__doc__
    )
    parser.add_argument("--name", required=True, help="of the cluster")
    folders = ClusterFolders(parser.parse_args().name)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    changed = threading.Event()
    nodes = RulesOfNodes(folders)
    objects = ClusterObjects(api_client(str(folders.kubeconfig)), changed)
    objects.start()
    controller = PolicyController(nodes.links, objects.observe, nodes.apply)
    reconcile(controller, lambda seconds: woken(changed, seconds), lambda report: report.write(folders), time.time)


if __name__ == "__main__":
    main()
