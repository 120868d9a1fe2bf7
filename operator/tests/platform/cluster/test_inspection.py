"""Strangers on the running platform: nothing that tests before ran was one; a static pod, a sidecar and a container in
somebody's pod are each named within 15 s in condition, metric and Event, and gone again when they are taken away."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from ci.cluster.embedded import outages
from ci.cluster.embedded.host.processes import Process, recorded
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.nodes import node_processes
from ci.images import image_lock
from robotkube.registry.admission.core.domain import account
from tests.stages import http_calls
from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.platform.runtime_calls import PodSandbox, remove_container, start_container

AGENT, OTHER_AGENT, RELEASE = "vehicle-02", "vehicle-01", "mqtt-bridge"
KUBELET = f"kubelet.{AGENT}"
RELEASES = "releases"
NAMED_SECONDS_MAX = 15
GONE_SECONDS_MAX = 30  # a Deployment without its sidecar again has its pod replaced
SETTLED_SECONDS_MAX = 120  # kubelets that tests before stopped are asked again after 30 s
WRITER = account("argocd", "argocd-application-controller")
CLEAN = {"Seen": "True", "Clean": "True"}


def inspection(platform: Platform, name: str) -> dict[str, Any]:
    """The status of an Inspection, with its conditions by type; the remover's is not asked for here."""
    status: dict[str, Any] = platform.get("-n", "robotkube", "inspections", name).get("status", {})
    conditions = {one["type"]: one["status"] for one in status.get("conditions", []) if one["type"] in CLEAN}
    return {**status, "conditions": conditions}


def reasons(platform: Platform, name: str) -> list[tuple[str, str, str]]:
    """Reason, name and container of each stranger of an Inspection."""
    listed = inspection(platform, name).get("strangers", [])
    return sorted((one["reason"], one["name"], one.get("container", "")) for one in listed)


def is_told(platform: Platform, looks_at: str, reason: str, words: str) -> None:
    """Metric and Event of a stranger stand beside its condition."""
    [pod] = platform.get("-n", "robotkube", "pods", "-l", "app.kubernetes.io/name=inspector")["items"]
    page = http_calls.get(f"http://{pod['status']['podIP']}:8081/metrics", timeout=10).text
    series = [line for line in page.splitlines() if line.startswith("robotkube_inspection_strangers{")]
    assert [line for line in series if f'looks_at="{looks_at}"' in line and f'reason="{reason}"' in line], page
    events = platform.get("-n", "robotkube", "events.events.k8s.io")["items"]
    assert [event for event in events if event["reason"] == reason and words in event.get("note", "")]


def nothing_strange(platform: Platform) -> bool:
    items = platform.get("-n", "robotkube", "inspections")["items"]
    names = [item["metadata"]["name"] for item in items]
    wanted = [RELEASES, *(f"kubelet.{node.name}" for node in platform.provider.nodes())]
    return set(wanted) <= set(names) and all(inspection(platform, name)["conditions"] == CLEAN for name in wanted)


def test_nothing_that_ran_so_far_is_strange(platform: Platform) -> None:
    """Pods of the platform, of its Jobs, of Argo CD, of suites and of all releases came and went."""
    eventually("everything was looked at, and is clean", lambda: nothing_strange(platform), SETTLED_SECONDS_MAX)
    said = platform.kubectl("-n", "robotkube", "logs", "deployment/inspector", "--tail=-1")
    assert [line for line in said.splitlines() if "stranger appeared" in line] == []


@contextmanager
def static_pods(platform: Platform, folder: Path) -> Iterator[None]:
    """The kubelet of the agent's machine reads pods from a folder, which it does nowhere else."""
    folders = ClusterFolders(platform.name)
    place = folders.node(AGENT) / "kubelet.yaml"
    before = place.read_text(encoding="utf-8")
    place.write_text(json.dumps({**json.loads(before), "staticPodPath": str(folder)}), encoding="utf-8")
    try:
        again(platform)
        yield
    finally:
        place.write_text(before, encoding="utf-8")
        again(platform)


def again(platform: Platform) -> None:
    """Have the kubelet start anew."""
    [kubelet] = _processes(platform, "kubelet")
    os.kill(kubelet.pid, signal.SIGKILL)
    eventually("the kubelet has ended", lambda: not kubelet.alive())
    outages.start(platform.name, AGENT)


def _processes(platform: Platform, what: str) -> list[Process]:
    return [one for one in recorded(ClusterFolders(platform.name)) if one.name == f"{AGENT}.{what}"]


@pytest.mark.thorough
def test_a_static_pod_is_named(platform: Platform, tmp_path: Path) -> None:
    pause = next(one for one in image_lock.read_lock(image_lock.lock_file()) if one.name == image_lock.SANDBOX)
    manifest = {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {"name": "static", "namespace": "default"},
        "spec": {"containers": [{"name": "main", "image": pause.reference, "imagePullPolicy": "Never"}]},
    }
    name = f"static-{AGENT}"
    with static_pods(platform, tmp_path):
        proxied = ("get", "--raw", f"/api/v1/nodes/{AGENT}/proxy/healthz")
        eventually("its kubelet answers again", lambda: platform.kubectl(*proxied) == "ok", SETTLED_SECONDS_MAX)
        (tmp_path / "static.yaml").write_text(json.dumps(manifest), encoding="utf-8")
        wanted = ("StaticPod", name, "")
        # a kubelet that was away may be asked 30 s later, and looks into the folder every 20 s when it misses a change
        eventually("it is named", lambda: wanted in reasons(platform, KUBELET), 50 + NAMED_SECONDS_MAX)
        is_told(platform, "kubelet", "StaticPod", name)
        (tmp_path / "static.yaml").unlink()
        eventually("it is gone", lambda: not reasons(platform, KUBELET), 20 + GONE_SECONDS_MAX)
    eventually("all is clean", lambda: nothing_strange(platform), SETTLED_SECONDS_MAX)


def patched(platform: Platform, agent: str, *operations: dict[str, Any]) -> None:
    """The release's Deployment changed as whoever may speak for Argo CD changes it: admission lets that pass."""
    words = ("patch", "deployment", RELEASE, "--type=json", f"--as={WRITER}", "-p", json.dumps(operations))
    platform.kubectl("-n", agent, *words)


def test_a_sidecar_and_an_annotation_that_argo_cd_calls_synced_are_named(platform: Platform) -> None:
    """Of the same release of two agents, which one look compares."""
    eventually("everything runs", platform.settled)
    template = platform.deployment(AGENT, RELEASE)["spec"]["template"]["spec"]
    own = template["containers"][0]
    sidecar = {
        "name": "sidecar",
        "image": own["image"],
        "command": ["python3", "-c", "import time; time.sleep(3600)"],
        "securityContext": own["securityContext"],
    }
    note = "/metadata/annotations/example.com~1note"
    patched(platform, AGENT, {"op": "add", "path": "/spec/template/spec/containers/-", "value": sidecar})
    patched(platform, OTHER_AGENT, {"op": "add", "path": note, "value": "x"})
    wanted = [("NotOfTheChart", RELEASE, "")] * 2
    try:
        eventually("both are named", lambda: reasons(platform, RELEASES) == wanted, NAMED_SECONDS_MAX)
        for words in ("sidecar added", "example.com/note"):
            is_told(platform, "releases", "NotOfTheChart", words)
    finally:
        patched(platform, AGENT, {"op": "remove", "path": "/spec/template/spec/containers/1"})
        patched(platform, OTHER_AGENT, {"op": "remove", "path": note})
    eventually("both are gone", lambda: not reasons(platform, RELEASES), GONE_SECONDS_MAX)
    eventually("all is clean", lambda: nothing_strange(platform), SETTLED_SECONDS_MAX)
    eventually("everything runs", platform.settled)


@pytest.fixture
def ctr(platform: Platform) -> Callable[..., str]:
    """`ctr` on the machine's own socket."""
    own = [str(platform.provider.binaries / "ctr"), "--address", str(runtime(platform)), "--namespace", "k8s.io"]

    def run(*words: str) -> str:
        return subprocess.run([*own, *words], check=True, capture_output=True, text=True, timeout=60).stdout

    return run


def runtime(platform: Platform) -> Path:
    [holder] = _processes(platform, "node")
    return node_processes.socket_of(holder)


@pytest.mark.thorough
def test_a_container_that_somebody_starts_in_a_known_pod_is_named(platform: Platform, ctr: Callable[..., str]) -> None:
    """By the machine's runtime, as part of the pod: neither API server nor kubelet were asked."""
    [pod] = platform.get("-n", AGENT, "pods", "-l", f"app.kubernetes.io/instance={RELEASE}")["items"]
    name, uid = pod["metadata"]["name"], pod["metadata"]["uid"]
    chosen = f'labels."io.kubernetes.pod.uid"=={uid},labels."io.cri-containerd.kind"==sandbox'
    sandbox = PodSandbox(ctr("containers", "ls", "-q", chosen).split()[0], name, AGENT, uid)
    image = pod["spec"]["containers"][0]["image"]
    command = ["python3", "-c", "import time; time.sleep(3600)"]
    container = start_container(runtime(platform), sandbox, "foreign", image, command)
    try:
        wanted = ("ForeignContainer", name, "foreign")
        eventually("it is named", lambda: wanted in reasons(platform, KUBELET), NAMED_SECONDS_MAX)
        is_told(platform, "kubelet", "ForeignContainer", "container foreign runs in pod")
    finally:
        remove_container(runtime(platform), container)
    eventually("it is gone", lambda: not reasons(platform, KUBELET), NAMED_SECONDS_MAX)
    events = platform.get("-n", "robotkube", "events.events.k8s.io")["items"]
    assert [event for event in events if event["reason"] == "StrangerGone" and "foreign" in event.get("note", "")]
    eventually("all is clean", lambda: nothing_strange(platform), SETTLED_SECONDS_MAX)
