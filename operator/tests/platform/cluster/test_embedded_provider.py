"""The embedded provider on this machine: pods, Services, names and volumes work on it, and nothing of it stays.

These tests start and remove the cluster `test` several times, so they cannot share it: a cluster that runs is stopped.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci import toolchain
from ci.cluster.embedded import cleaning, outages
from ci.cluster.embedded.host import processes
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network import host_network
from ci.cluster.embedded.network.addresses import plan_of
from ci.cluster.embedded.network_policies import enforcement
from ci.cluster.embedded.nodes.node_processes import OWN_PLACES, socket_of
from ci.cluster.embedded.provider import Embedded
from ci.cluster_contract import topology
from ci.folders import PROJECT, user_cache
from ci.images import image_lock
from ci.machine import cgroups, network_policies
from tests.stages.platform import probe_image
from tests.stages.waiting import until

NAME = "test"
PLAN = plan_of(NAME)
COMMAND_TIMEOUT_SECONDS = 120
NODES = [
    {"name": "platform-0", "role": "platform", "agent": "platform-0", "capacity": {"cpu": "1", "memory": "1Gi"}},
    {"name": "cloud-0", "role": "cloud", "agent": "cloud-0", "capacity": {"cpu": "1", "memory": "1Gi"}},
    {"name": "vehicle-00", "role": "vehicle", "agent": "vehicle-00", "capacity": {"cpu": "1", "memory": "1Gi"}},
]
# Where a start is killed, by what it has started last; the others are among the slower proofs.
KILLED_AT, ALSO = ("kube-apiserver", "vehicle-00.kubelet"), ("vehicle-00.node", "etcd", "cloud-0.containerd")
RESTRICTED = {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}, "readOnlyRootFilesystem": True}


@pytest.fixture(scope="module")
def lock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return probe_image.build(tmp_path_factory.mktemp("images") / "lock")


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "scenario.yaml"
    path.write_text(yaml.safe_dump({"topology": {"nodes": NODES}}), encoding="utf-8")
    return path


def machine() -> dict[str, Any]:
    """What a cluster could leave behind, as the kernel tells it (image builds may mount elsewhere meanwhile)."""
    mounts = [line.split()[4] for line in Path("/proc/self/mountinfo").read_text(encoding="utf-8").splitlines()]
    kept = [user_cache() / "clusters", user_cache() / "imported", Path("/run/containerd"), Path("/run/netns/cni-")]
    ours = (*map(str, kept), *(str(place) for name, place in OWN_PLACES.items() if name != "run"))
    return {
        "links": sorted(entry["ifname"] for entry in json.loads(host_network.run(["ip", "-json", "link", "show"]))),
        "routes": host_network.run(["ip", "route", "show"]),
        "tables": host_network.run(["nft", "list", "tables"]),
        "mounts": sorted(place for place in mounts if place.startswith(ours)),
        "groups": sorted(str(path) for path in Path("/sys/fs/cgroup").glob("**/robotkube-*")),
        "sysctls": {
            name: Path("/proc/sys", name.replace(".", "/")).read_text()
            for name in host_network.AT_LEAST | host_network.EXACTLY
        },
        "folders": [str(place) for place in OWN_PLACES.values() if place.exists()],
        "processes": sorted(processes.strays("test") | processes.strays("demo")),
    }


@pytest.fixture(scope="module")
def before(no_demo: None) -> dict[str, Any]:
    cleaning.remove(NAME)
    return machine()


class Kubectl:
    """kubectl as administrator of the test cluster."""

    def __init__(self, cluster: Embedded) -> None:
        self.command = [str(cluster.binaries / "kubectl"), f"--kubeconfig={cluster.kubeconfig()}"]

    def __call__(self, *arguments: str, given: object = None, code: int | None = 0) -> str:
        done = subprocess.run(
            [*self.command, *arguments],
            input=json.dumps(given) if given is not None else None,
            capture_output=True,
            text=True,
            timeout=COMMAND_TIMEOUT_SECONDS,
            check=False,
        )
        assert code is None or done.returncode == code, done.stderr
        return done.stdout + done.stderr


@pytest.fixture(scope="module", autouse=True)
def enforced() -> Iterator[None]:
    """Network policies are enforced on the clusters of this module, whatever the default is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(network_policies.VARIABLE, network_policies.ON)
        yield


@pytest.fixture(scope="module")
def cluster(before: dict[str, Any], lock: Path, scenario: Path) -> Iterator[Embedded]:
    assert before["processes"] == []
    running = Embedded(NAME, toolchain.ensure().binaries)
    running.up(topology.read(scenario), image_lock.read_lock(lock))
    yield running
    running.down()


def pod(name: str, agent: str, reference: str, *arguments: str, claim: str = "") -> dict[str, Any]:
    container: dict[str, Any] = {"name": "probe", "image": reference, "args": list(arguments)}
    container["securityContext"] = RESTRICTED
    specification: dict[str, Any] = {
        "nodeSelector": {"robotkube.io/agent": agent},
        "securityContext": {"runAsNonRoot": True, "fsGroup": 5000, "seccompProfile": {"type": "RuntimeDefault"}},
        "containers": [container],
    }
    if claim:
        container["volumeMounts"] = [{"name": "data", "mountPath": "/data"}]
        specification["volumes"] = [{"name": "data", "persistentVolumeClaim": {"claimName": claim}}]
    labels = {"app": name}
    metadata = {"name": name, "namespace": "probe", "labels": labels}
    return {"apiVersion": "v1", "kind": "Pod", "metadata": metadata, "spec": specification}


@pytest.fixture(scope="module")
def probes(cluster: Embedded, lock: Path) -> Kubectl:
    """A server with a volume on cloud-0 behind the Service `web`, and a client on vehicle-00, both Ready."""
    kubectl = Kubectl(cluster)
    reference = next(image.reference for image in image_lock.read_lock(lock) if image.name == "probe")
    label = {"pod-security.kubernetes.io/enforce": "restricted"}
    claim = {"accessModes": ["ReadWriteOnce"], "resources": {"requests": {"storage": "20Gi"}}}
    service = {"selector": {"app": "web"}, "ports": [{"port": 80, "targetPort": 8080}]}
    inside = {"namespace": "probe"}
    items = [
        {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "probe", "labels": label}},
        {"apiVersion": "v1", "kind": "PersistentVolumeClaim", "metadata": {"name": "data", **inside}, "spec": claim},
        {"apiVersion": "v1", "kind": "Service", "metadata": {"name": "web", **inside}, "spec": service},
        pod("web", "cloud-0", reference, "serve", "8080", claim="data"),
        pod("client", "vehicle-00", reference),
    ]
    kubectl("apply", "-f", "-", given={"apiVersion": "v1", "kind": "List", "items": items})
    kubectl("-n", "probe", "wait", "--for=condition=Ready", "pod", "--all", "--timeout=60s")
    return kubectl


def client(kubectl: Kubectl, address: str, code: int | None = 0) -> str:
    return kubectl("-n", "probe", "exec", "client", "--", "/probe", "get", address, code=code)


def eventually(kubectl: Kubectl, address: str, expected: str, seconds: float | None = None) -> None:
    """Wait until that is the answer: kube-proxy hears of a new endpoint a moment later."""
    until(lambda: client(kubectl, address, code=None) == expected, f"{address} answers {expected!r}", seconds)


def test_nodes_have_labels_taints_and_capacity(cluster: Embedded) -> None:
    items = cluster.api().get("/api/v1/nodes")["items"]
    nodes = {item["metadata"]["name"]: item for item in items}
    assert [node.name for node in cluster.nodes()] == ["platform-0", "cloud-0", "vehicle-00"]
    assert nodes["platform-0"]["spec"]["taints"][0]["effect"] == "NoSchedule"
    assert nodes["cloud-0"]["metadata"]["labels"]["robotkube.io/agent"] == "cloud-0"
    assert nodes["vehicle-00"]["status"]["allocatable"]["cpu"] == "1"
    assert nodes["vehicle-00"]["status"]["allocatable"]["memory"] == "1Gi"


def test_pods_reach_services_by_name_across_nodes(probes: Kubectl) -> None:
    eventually(probes, "http://web.probe.svc.cluster.local/", "web\n")


def test_a_proxy_that_ended_is_started_again(probes: Kubectl) -> None:
    """It is known to panic now and then while it starts; a node without it reaches no Service made since."""
    daemon = "vehicle-00.kube-proxy"
    [guard] = [process for process in processes.recorded(ClusterFolders(NAME)) if process.name == daemon]
    children = Path(f"/proc/{guard.pid}/task/{guard.pid}/children")
    [proxy] = map(int, children.read_text(encoding="ascii").split())
    os.kill(proxy, signal.SIGKILL)
    service = {"selector": {"app": "web"}, "ports": [{"port": 80, "targetPort": 8080}]}
    metadata = {"name": "again", "namespace": "probe"}
    probes("apply", "-f", "-", given={"apiVersion": "v1", "kind": "Service", "metadata": metadata, "spec": service})
    eventually(probes, "http://again.probe.svc.cluster.local/", "web\n")
    assert children.read_text(encoding="ascii").split() != [str(proxy)]
    assert "/kube-proxy ended with 137: started again in 1 s" in Path(guard.log).read_text(encoding="utf-8")


def test_the_host_reaches_services_and_pods(cluster: Embedded, probes: Kubectl) -> None:
    eventually(probes, "http://web.probe/", "web\n")
    service = cluster.api().get("/api/v1/namespaces/probe/services/web")["spec"]["clusterIP"]
    address = cluster.api().get("/api/v1/namespaces/probe/pods/web")["status"]["podIP"]
    for url in (f"http://{service}/", f"http://{address}:8080/"):
        command = ["curl", "--silent", "--fail", "--max-time", "5", url]
        assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "web\n"


@pytest.mark.parametrize(
    ("address", "refusal"),
    [
        (f"http://{PLAN.gateway}:2379/", "deadline exceeded"),
        ("http://192.0.2.1/", "network is unreachable"),
        ("http://example.com/", "no such host"),
    ],
)
def test_pods_reach_nothing_else(probes: Kubectl, address: str, refusal: str) -> None:
    assert refusal in client(probes, address, code=1)


def test_network_policies_are_enforced(cluster: Embedded, probes: Kubectl) -> None:
    """The server's own node reaches it all the same, as its probes do; elsewhere nobody does while none is allowed."""
    eventually(probes, "http://web.probe/", "web\n")
    address = cluster.api().get("/api/v1/namespaces/probe/pods/web")["status"]["podIP"]
    spec = {"podSelector": {"matchLabels": {"app": "web"}}, "policyTypes": ["Ingress"]}
    metadata = {"name": "web", "namespace": "probe"}
    kinds = {"apiVersion": "networking.k8s.io/v1", "kind": "NetworkPolicy", "metadata": metadata}
    probes("apply", "-f", "-", given={**kinds, "spec": spec})
    until(lambda: "deadline exceeded" in client(probes, "http://web.probe/", code=None), "the policy is at work")
    url = f"http://{address}:8080/"
    assert not reads(url)
    holder = enforcement.holders(ClusterFolders(NAME))["cloud-0"]
    assert reads(url, "nsenter", f"--net=/proc/{holder.pid}/ns/net")
    clients = [{"podSelector": {"matchLabels": {"app": "client"}}}]
    probes("apply", "-f", "-", given={**kinds, "spec": {**spec, "ingress": [{"from": clients}]}})
    eventually(probes, "http://web.probe/", "web\n")
    assert not reads(url)
    probes("-n", "probe", "delete", "networkpolicy", "web")
    until(lambda: reads(url), "without a policy everybody is let in")
    until(lambda: cluster.status().endswith("network policies: 0 enforced on 3 nodes"), "the status says so")


def reads(url: str, *through: str) -> bool:
    """Return whether the machine, or whoever it asks through, reads a page."""
    command = [*through, "curl", "--silent", "--fail", "--max-time", "3", url]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def test_the_process_that_follows_policies_is_started_again(probes: Kubectl) -> None:
    """Without it new pods would stay cut off."""
    [guard] = [one for one in processes.recorded(ClusterFolders(NAME)) if one.name == enforcement.PROCESS]
    children = Path(f"/proc/{guard.pid}/task/{guard.pid}/children")
    [follower] = map(int, children.read_text(encoding="ascii").split())
    os.kill(follower, signal.SIGKILL)
    reference = json.loads(probes("-n", "probe", "get", "pod", "client", "-o", "json"))["spec"]["containers"][0][
        "image"
    ]
    probes("apply", "-f", "-", given=pod("late", "vehicle-00", reference))
    probes("-n", "probe", "wait", "--for=condition=Ready", "pod", "late", "--timeout=60s")

    def asks() -> bool:
        return probes("-n", "probe", "exec", "late", "--", "/probe", "get", "http://web.probe/", code=None) == "web\n"

    until(asks, "a new pod reaches others")
    probes("-n", "probe", "delete", "pod", "late", "--grace-period=1")
    assert children.read_text(encoding="ascii").split() != [str(follower)]


def test_a_claim_is_a_folder_that_the_pods_group_may_write(cluster: Embedded, probes: Kubectl) -> None:
    probes("-n", "probe", "exec", "web", "--", "/probe", "write", "/data/file")
    folder = cluster.volume_path("probe", "data")
    assert folder.is_relative_to(ClusterFolders(NAME).volumes / "cloud-0")
    assert (folder / "file").read_text(encoding="utf-8") == "written\n"
    assert folder.stat().st_gid == 5000


def test_every_node_has_every_image_under_its_digest(cluster: Embedded, lock: Path) -> None:
    expected = {image.reference for image in image_lock.read_lock(lock)}
    holders = [process for process in processes.recorded(ClusterFolders(NAME)) if process.name.endswith(".node")]
    assert len(holders) == len(NODES)
    for holder in holders:
        control = [str(cluster.binaries / "ctr"), "--address", str(socket_of(holder)), "--namespace", "k8s.io"]
        listed = subprocess.run([*control, "images", "list"], capture_output=True, text=True, check=True).stdout
        digests = {line.split()[0]: line.split()[2] for line in listed.splitlines() if "@sha256:" in line.split()[0]}
        assert expected <= set(digests)
        assert all(reference.endswith(digest) for reference, digest in digests.items())


def test_up_again_uses_the_running_cluster(cluster: Embedded, lock: Path, scenario: Path) -> None:
    record = [process.pid for process in processes.recorded(ClusterFolders(NAME))]
    cluster.up(topology.read(scenario), image_lock.read_lock(lock))
    assert [process.pid for process in processes.recorded(ClusterFolders(NAME))] == record


def test_status_shows_nodes_pods_and_costs(cluster: Embedded, probes: Kubectl) -> None:
    table = cluster.status()
    assert "vehicle-00" in table
    assert "probe" in table
    assert "kube-apiserver" in table


def test_a_node_that_was_stopped_comes_back_with_its_pods_and_volumes(cluster: Embedded, probes: Kubectl) -> None:
    names = tuple(f"cloud-0.{daemon}" for daemon in outages.DAEMONS)
    probes("-n", "probe", "exec", "web", "--", "/probe", "write", "/data/kept")
    cluster.stop_node("cloud-0")
    assert cgroups.processes_of_node(NAME, "cloud-0", names) == set()
    assert cgroups.processes_of_node(NAME, "vehicle-00", ()) != set()
    cluster.start_node("cloud-0")
    eventually(probes, "http://web.probe.svc.cluster.local/", "web\n", 60.0)
    assert (cluster.volume_path("probe", "data") / "kept").exists()


def test_down_leaves_the_machine_as_it_was(cluster: Embedded, probes: Kubectl, before: dict[str, Any]) -> None:
    assert cleaning.leftovers(NAME)
    removed = cluster.down()
    assert cleaning.leftovers(NAME) == ()
    assert machine() == before
    assert {line.split()[0] for line in removed} >= {"links:", "nftables:", "files"}
    counted = ("process", "network namespace", "control group")
    assert [word for word in counted if not any(word in line for line in removed)] == [], removed
    assert cluster.down() == ()


@pytest.mark.parametrize("process", [*KILLED_AT, *(pytest.param(name, marks=pytest.mark.thorough) for name in ALSO)])
def test_a_start_killed_half_way_leaves_nothing_after_down(
    before: dict[str, Any], lock: Path, scenario: Path, process: str
) -> None:
    command = [sys.executable, "-m", "ci.cluster", "up", "--name", NAME, "--topology", str(scenario)]
    start = subprocess.Popen([*command, "--images", str(lock)], cwd=PROJECT, start_new_session=True)
    try:
        until(lambda: has_started(process), f"{process} starts", COMMAND_TIMEOUT_SECONDS)
    finally:
        start.send_signal(signal.SIGKILL)
        start.wait(timeout=10)
    down = [sys.executable, "-m", "ci.cluster", "down", "--name", NAME]
    subprocess.run(down, cwd=PROJECT, check=True, timeout=COMMAND_TIMEOUT_SECONDS)
    assert cleaning.leftovers(NAME) == ()
    assert machine() == before


def has_started(process: str) -> bool:
    """Return whether the cluster's start has come so far that it has recorded a process of this name."""
    return process in {one.name for one in processes.recorded(ClusterFolders(NAME))}
