"""Policies of a real API server at work between real network namespaces: followed at once, closed to what is new, right
after the API server or the process that follows was away."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest

from ci.cluster.embedded.host import followers
from ci.cluster.embedded.host.processes import Process
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.pod_links import RESULTS, PodLink
from ci.cluster.embedded.network_policies import enforcement
from ci.cluster.embedded.network_policies.controller import NAMESPACES
from ci.cluster.embedded.network_policies.enforcement import MODULE, PROCESS, SILENT_SECONDS_MAX, status
from ci.machine.network_policies import VARIABLE
from robotkube.foundation.kubernetes.core.network_policies import NetworkPeer
from tests.stages import programs
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.network.nft_meaning import PlacedPod
from tests.stages.network.real_nodes import RealNodes, key
from tests.stages.network.results import write_result
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

HTTP = ("TCP", 8080)


def placed(name: str, node: int, number: int) -> PlacedPod:
    return PlacedPod(NetworkPeer(name, f"10.244.{node}.{number}", "shop"), f"node-{node}", f"veth{name}")


WEB, STORE, FAR, NEW = placed("web", 1, 2), placed("store", 1, 3), placed("far", 2, 2), placed("new", 1, 4)
PODS = (WEB, STORE, FAR, NEW)


@dataclass
class Server:
    """The API server, asked as the provider asks it."""

    process: ApiServerProcess
    client: httpx.Client
    pods: dict[str, str] = field(default_factory=dict)  # name -> uid

    def make(self, path: str, name: str, spec: Any = None) -> dict[str, Any]:
        """A new object."""
        labels = {"app": name}
        body = {"metadata": {"name": name, "labels": labels}} | ({"spec": spec} if spec else {})
        answer = self.client.post(path, json=body)
        assert answer.is_success, answer.text
        return dict(answer.json())

    def pod(self, name: str) -> str:
        """A new pod; its uid."""
        containers = [{"name": "main", "image": "image", "ports": [{"name": "http", "containerPort": 8080}]}]
        made = self.make("/api/v1/namespaces/shop/pods", name, {"containers": containers})
        return str(made["metadata"]["uid"])

    def policy(self, name: str, **spec: Any) -> str:
        """A new policy; its path."""
        path = "/apis/networking.k8s.io/v1/namespaces/shop/networkpolicies"
        self.make(path, name, {"podSelector": {}, **spec})
        return f"{path}/{name}"

    def delete(self, path: str) -> None:
        """Take an object away."""
        assert self.client.delete(path).is_success


@dataclass
class Enforced:
    """The process that follows, and what it works on."""

    server: Server
    nodes: RealNodes
    folders: ClusterFolders
    guard: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the process as the provider does, and what starts it again."""
        command = [*followers.STARTED_AGAIN, *followers.command(MODULE, self.folders)]
        environment = {"PATH": os.environ["PATH"], **followers.environment()}
        with self.log.open("a") as said:
            self.guard = subprocess.Popen(command, env=environment, stdout=said, stderr=said, start_new_session=True)

    def stop(self) -> None:
        """End both."""
        if self.guard and self.guard.poll() is None:
            os.killpg(self.guard.pid, signal.SIGKILL)
            self.guard.wait(10)

    def kill(self) -> None:
        """End the process alone."""
        assert self.guard
        children = Path(f"/proc/{self.guard.pid}/task/{self.guard.pid}/children").read_text(encoding="ascii")
        os.kill(int(children), signal.SIGKILL)

    @property
    def log(self) -> Path:
        """What it said."""
        self.folders.log.mkdir(parents=True, exist_ok=True)
        return self.folders.log / f"{PROCESS}.log"

    def attach(self, pod: PlacedPod, uid: str) -> Path:
        """The node gives a pod its address."""
        link = PodLink(pod.port, pod.peer.address, pod.peer.namespace, pod.peer.name, uid)
        return write_result(self.folders.node(pod.node) / "cni-state" / RESULTS, link)

    def known(self, pod: PlacedPod) -> bool:
        """Return whether the pod has rules."""
        return f'"{pod.port}" . {pod.peer.address}' in self.nodes.inside(pod.node, "nft", "list", "ruleset")

    def reach(self, source: PlacedPod, target: PlacedPod) -> bool:
        """Return whether one pod reaches another."""
        return self.nodes.reaches(key(source), key(target), target.peer.address, HTTP)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    process = ApiServerProcess(tmp_path_factory.mktemp("server"))
    try:
        process.start()
        headers = {"Authorization": f"Bearer {process.token}"}
        base = f"https://127.0.0.1:{process.port}"
        with httpx.Client(base_url=base, headers=headers, verify=False, timeout=10) as client:  # noqa: S501
            started = Server(process, client)
            started.make(NAMESPACES, "shop")
            started.pods = {pod.peer.name: started.pod(pod.peer.name) for pod in (WEB, STORE, FAR)}
            yield started
    finally:
        process.stop()


@pytest.fixture
def enforced(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Enforced]:
    """Two nodes with three pods, closed before the first one, and followed."""
    programs.folder()  # before the cache is another
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folders = ClusterFolders("demo")
    nodes = RealNodes(PODS)
    stage = Enforced(server, nodes, folders)
    try:
        nodes.start()
        for node in nodes.nodes:
            enforcement.close(nodes.holder(node))
            record(folders, nodes.holder(node))
        for pod in (WEB, STORE, FAR):
            stage.attach(pod, server.pods[pod.peer.name])
        folders.kubeconfig.write_text(server.process.kubeconfig.read_text(encoding="utf-8"), encoding="utf-8")
        stage.start()
        until(lambda: all(stage.known(pod) for pod in (WEB, STORE, FAR)), "the pods have rules")
        yield stage
    finally:
        stage.stop()
        nodes.close()
        server.delete("/apis/networking.k8s.io/v1/namespaces/shop/networkpolicies")


def record(folders: ClusterFolders, process: Process) -> None:
    """As the launcher records what it has started."""
    folders.processes.mkdir(parents=True, exist_ok=True)
    (folders.processes / f"{process.name}.json").write_text(json.dumps(asdict(process)), encoding="utf-8")


def test_policies_are_followed_while_they_come_change_and_go(enforced: Enforced) -> None:
    assert enforced.reach(WEB, STORE)
    deny = enforced.server.policy("deny")
    until(lambda: not enforced.reach(WEB, STORE), "the policy is at work on one node")
    until(lambda: not enforced.reach(FAR, STORE), "and from another")
    allow = enforced.server.policy(
        "allow", ingress=[{"from": [{"podSelector": {"matchLabels": {"app": "web"}}}], "ports": [{"port": "http"}]}]
    )
    until(lambda: enforced.reach(WEB, STORE), "what is allowed passes")
    assert not enforced.reach(FAR, STORE)
    label = {"metadata": {"labels": {"app": "web"}}}
    kind = {"Content-Type": "application/merge-patch+json"}
    assert enforced.server.client.patch("/api/v1/namespaces/shop/pods/far", json=label, headers=kind).is_success
    until(lambda: enforced.reach(FAR, STORE), "a pod is whom its labels say")
    for path in (allow, deny):
        enforced.server.delete(path)
    label = {"metadata": {"labels": {"app": "far"}}}
    assert enforced.server.client.patch("/api/v1/namespaces/shop/pods/far", json=label, headers=kind).is_success
    until(lambda: enforced.reach(STORE, FAR), "without policies everybody is free")


def test_a_new_pod_is_cut_off_until_the_rules_know_it(enforced: Enforced) -> None:
    """It has its address before the API server says who it is; nobody reaches it, and nothing comes from it."""
    assert not enforced.reach(WEB, NEW)
    path = enforced.attach(NEW, "uid-of-nobody")
    enforced.server.policy("deny-web", podSelector={"matchLabels": {"app": "web"}})
    until(lambda: not enforced.reach(STORE, WEB), "the rules are of now")
    assert not enforced.known(NEW)
    assert not enforced.reach(STORE, NEW)
    path.unlink()
    enforced.attach(NEW, enforced.server.pod("new"))
    until(lambda: enforced.known(NEW), "it has rules")
    assert enforced.reach(STORE, NEW)
    assert enforced.reach(NEW, STORE)
    assert not enforced.reach(NEW, WEB)
    enforced.server.delete("/api/v1/namespaces/shop/pods/new?gracePeriodSeconds=0")
    until(lambda: not enforced.known(NEW), "who went is cut off")


def test_rules_stay_while_the_api_server_is_away_and_follow_when_it_is_back(enforced: Enforced) -> None:
    enforced.server.policy("deny")
    until(lambda: not enforced.reach(WEB, STORE), "the policy is at work")
    enforced.server.process.stop_server()
    enforced.attach(NEW, "uid-of-nobody")
    until(lambda: "new pods are cut off: " in said(enforced), "it says that it cannot follow")
    assert "API server: GET " in said(enforced)
    assert not enforced.reach(WEB, STORE)
    assert not enforced.reach(WEB, NEW)
    enforced.server.process.start_server()
    until(lambda: said(enforced) == "network policies: 1 enforced on 2 nodes", "it follows again")
    enforced.server.policy("open", ingress=[{}])
    until(lambda: enforced.reach(WEB, STORE), "what is new is at work")


def test_rules_stay_while_nobody_follows_and_are_right_when_somebody_does(enforced: Enforced) -> None:
    path = enforced.server.policy("deny")
    until(lambda: not enforced.reach(WEB, STORE), "the policy is at work")
    enforced.stop()
    enforced.server.delete(path)
    enforced.server.policy("deny-far", podSelector={"matchLabels": {"app": "far"}})
    assert not enforced.reach(WEB, STORE)
    assert not enforced.reach(WEB, NEW)
    enforced.start()
    until(lambda: enforced.reach(WEB, STORE), "it is right again")
    assert not enforced.reach(WEB, FAR)


@pytest.mark.thorough
def test_a_process_that_is_killed_is_started_again(enforced: Enforced) -> None:
    enforced.server.policy("deny")
    until(lambda: not enforced.reach(WEB, STORE), "the policy is at work")
    enforced.kill()
    assert not enforced.reach(WEB, STORE)
    enforced.server.policy("open", ingress=[{}])
    until(lambda: enforced.reach(WEB, STORE), "what is new is at work")
    assert "ended with 137: started again in 1 s" in enforced.log.read_text(encoding="utf-8")


def said(enforced: Enforced, now: float | None = None) -> str:
    """The sentence of a cluster that was started with policies enforced."""
    record(enforced.folders, Process(PROCESS, 1, 0, ("python",), ""))
    return status(enforced.folders, now)


def test_the_status_says_what_is_enforced(enforced: Enforced) -> None:
    assert status(enforced.folders) == f"network policies: not enforced (the cluster was started with {VARIABLE}=off)"
    until(lambda: said(enforced) == "network policies: 0 enforced on 2 nodes", "it follows")
    silent = said(enforced, time.time() + SILENT_SECONDS_MAX + 1)
    assert (
        "the rules of 2 nodes stay as they are, new pods are cut off: the process network-policies does not" in silent
    )
    enforced.stop()
    enforced.nodes.inside("node-2", "nft", "flush", "ruleset")
    assert said(enforced) == "network policies: NOT enforced on node-2: start the cluster anew"
