"""Containers on a real node: what its kubelet starts is known from its first moment to its last, and what anybody else
starts by the same runtime is not, whatever it says of itself."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator

import pytest

from ci.cluster.embedded.containers import beside_kubelets, reports
from ci.cluster.embedded.containers.beside_kubelets import GRACE_SECONDS, RuntimeContainer
from ci.cluster.embedded.containers.node_containers import ANNOTATIONS, RUNNING, SPECIFICATION
from ci.cluster.embedded.containers.polling import ContainerPoll, ContainersOfNodes
from ci.cluster.embedded.control_plane.pki import Authority, Identity
from ci.cluster.embedded.host import followers, processes, runc_records
from robotkube.delivery.inspection.core.strangers import Stranger
from tests.stages.attacks import shown
from tests.stages.kubernetes.lone_node import CLUSTER, LoneNode, lone_node
from tests.stages.platform import probe_image
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

FOREIGN = "foreign"
MAIN = f"""
from ci.cluster.embedded.containers import polling
from ci.cluster.embedded.network import addresses
addresses.PLANS["{CLUSTER}"] = addresses._plan("{CLUSTER}", "127.91.0.0/24", "10.246.0.0/16", "10.98.0.0/16")
polling.main()
"""


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LoneNode]:
    """A node whose kubelet runs the pod `web`."""
    with lone_node(probe_image.build(tmp_path_factory.mktemp("images") / "lock")) as running:
        running.start_kubelet()
        running.run_pod("web", {"containers": [{"name": "web", "image": running.reference("probe")}]})
        until(lambda: web(running), "its container is known", 60)
        yield running


@pytest.fixture
def foreign(node: LoneNode) -> Iterator[LoneNode]:
    """The node, on which nothing of a test stays."""
    yield node
    for namespace in node.ctr("namespaces", "list", "--quiet").split():
        if FOREIGN in node.ctr("--namespace", namespace, "containers", "list", "--quiet").split():
            end(node, namespace)


def read(node: LoneNode) -> beside_kubelets.NodeContents:
    nodes = ContainersOfNodes(node.folders)
    assert list(nodes.names()) == [node.node.name]
    return nodes.read(node.node.name)


def unknown(node: LoneNode) -> list[str]:
    return [one.container.key for one in beside_kubelets.unknown(read(node))]


def web(node: LoneNode) -> RuntimeContainer | None:
    """The container of the kubelet's pod, once it is known."""
    gone = unknown(node)
    return next(
        (container for container in read(node).containers if container.name == "web" and container.key not in gone),
        None,
    )


def run(node: LoneNode, namespace: str, *options: str) -> None:
    """Start a container as anybody does who reaches the runtime."""
    image = next(one for one in node.lock if one.name == "probe")
    own = ("--namespace", namespace)
    node.ctr(*own, "images", "import", "--local", "--digests", "--base-name", image.repository, str(image.archive))
    node.ctr(*own, "run", "--detach", "--null-io", *options, image.reference, FOREIGN)


def end(node: LoneNode, namespace: str) -> None:
    node.ctr("--namespace", namespace, "tasks", "kill", "--signal", "SIGKILL", FOREIGN)
    until(lambda: "STOPPED" in node.ctr("--namespace", namespace, "tasks", "list"), "it ends")
    node.ctr("--namespace", namespace, "tasks", "delete", FOREIGN)
    node.ctr("--namespace", namespace, "containers", "delete", FOREIGN)


def named(poll: ContainerPoll) -> list[Stranger]:
    [look] = poll.looks()
    assert not look.problem
    return list(look.strangers)


def test_a_container_beside_the_kubelet_is_named_until_it_ends(foreign: LoneNode) -> None:
    poll = ContainerPoll(ContainersOfNodes(foreign.folders), time.monotonic)
    assert named(poll) == []
    run(foreign, "default")
    [one] = named(poll)
    assert (one.name, one.reason) == ("default/foreign", "BesideTheKubelet")
    assert "runs /probe" in one.message
    shown("nodes", one.message, "beside-the-kubelet")
    end(foreign, "default")
    assert named(poll) == []


def test_one_in_the_kubelets_namespace_is_named_when_its_kubelet_does_not_write_it_down(foreign: LoneNode) -> None:
    now = 0.0
    poll = ContainerPoll(ContainersOfNodes(foreign.folders), lambda: now)
    run(foreign, "k8s.io")
    assert named(poll) == []
    now += GRACE_SECONDS
    assert [one.name for one in named(poll)] == ["k8s.io/foreign"]


@pytest.mark.parametrize("as_what", ["container", "sandbox"])
def test_what_it_says_of_itself_does_not_make_it_the_kubelets(foreign: LoneNode, as_what: str) -> None:
    """All the words of a container that the kubelet started."""
    genuine = web(foreign)
    assert genuine
    file = foreign.node.folder / RUNNING[0] / "k8s.io" / genuine.id / SPECIFICATION
    said = {key: word for key, word in json.loads(file.read_text())["annotations"].items() if ANNOTATIONS in key}
    said |= {f"{ANNOTATIONS}container-type": as_what}
    options = [word for key, value in said.items() for word in ("--annotation", f"{key}={value}")]
    options += ["--label", f"io.kubernetes.pod.uid={genuine.pod_uid}", "--label", "io.kubernetes.container.name=web"]
    run(foreign, "k8s.io", *options)
    assert unknown(foreign) == ["k8s.io/foreign"]
    [one] = beside_kubelets.unknown(read(foreign))
    assert "of pod vehicle-00/web-vehicle-00" in one.why


def test_pods_that_come_and_go_raise_no_alarm(node: LoneNode) -> None:
    """With a container that prepares, one that fails, and an image that is not there: the sandbox stays alone."""
    image = node.reference("probe")
    poll = ContainerPoll(ContainersOfNodes(node.folders), time.monotonic)
    steps = [{"name": "prepare", "image": image, "args": ["read", "/proc/self/comm"]}]
    works = {"initContainers": steps, "containers": [{"name": "works", "image": image}]}
    fails = {"containers": [{"name": "fails", "image": image, "args": ["read", "/nothing"]}]}
    lacks = {"containers": [{"name": "lacks", "image": "nowhere.example/x:1", "imagePullPolicy": "Never"}]}
    pods = [node.run_pod(name, spec) for name, spec in (("works", works), ("fails", fails), ("lacks", lacks))]

    def watched() -> set[str]:
        """The pods that have something known that runs; nothing is named."""
        assert named(poll) == []
        gone = unknown(node)
        return {
            container.pod.removesuffix(f"-{node.node.name}")
            for container in read(node).containers
            if container.key not in gone
        }

    until(lambda: watched() >= {"works", "fails", "lacks"}, "all have begun", 60)
    until(lambda: started(node, "works") and started(node, "fails"), "two run", 60)
    assert watched() >= {"lacks"}
    for path in pods:
        path.unlink()
    until(lambda: watched() == {"web"}, "all have ended", 90)


def started(node: LoneNode, name: str) -> bool:
    return any(link.startswith(f"{name}-") and f"_{name}-" in link for link in read(node).links)


def test_the_process_names_it_where_nothing_can_be_written(foreign: LoneNode) -> None:
    """Started as the provider starts it, for a cluster whose API server does not answer; it ends with its node."""
    folders, launcher = foreign.folders, foreign.launcher
    Authority(folders.pki).create()
    Authority(folders.pki).issue(Identity("admin", "admin", ("system:masters",)))
    command = [sys.executable, "-c", MAIN, "--name", CLUSTER]
    launcher.start(reports.PROCESS, command, followers.STARTED_AGAIN, followers.environment())
    until(lambda: "none beside the kubelets of 1 nodes" in reports.status(folders), "it looks")
    run(foreign, "default")
    until(lambda: "1 STARTED BESIDE THE KUBELETS" in reports.status(folders), "it is named", 15)
    log = folders.log / f"{reports.PROCESS}.log"
    words = "container default/foreign on node vehicle-00 runs /probe"
    until(lambda: words in log.read_text(encoding="utf-8"), "it is logged")
    count = log.read_text(encoding="utf-8").count("the Inspections do not say what was seen")
    assert count == 2, "once, and once more with what runs beside the kubelet"
    end(foreign, "default")
    until(lambda: "none beside" in reports.status(folders), "it is gone", 15)


def test_it_ends_with_its_node(node: LoneNode) -> None:
    """No record of the cluster has it; the end of the node's stage kills it, and says what stays."""
    nodes = node.folders.nodes
    assert runc_records.foreign_groups(nodes, CLUSTER) == ()
    before = processes.in_containers(nodes)
    run(node, "default")
    assert len(processes.in_containers(nodes) - before) == 1
    assert {path.name for path in runc_records.foreign_groups(nodes, CLUSTER)} == {FOREIGN}
