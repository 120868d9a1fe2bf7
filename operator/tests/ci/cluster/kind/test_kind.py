"""Clusters by kind: what kind is told, when one is made anew, and what is said when it fails. kind is a program of the
test, which writes down what it was asked."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from ci.cluster.kind import provider
from ci.cluster.kind.configuration import WORKERS, configuration, shared_out
from ci.cluster.kind.provider import KindCluster
from ci.cluster_contract import topology
from ci.cluster_contract.topology import Topology
from ci.errors import InputError, SetUpError
from ci.kind_node_image import engines, naming
from robotkube.foundation.kubernetes.core.node_agents import node_agents
from tests.stages.paths import SCENARIOS
from tests.stages.registry.built_images import built_image

pytestmark = pytest.mark.toolchain

SCENARIO = SCENARIOS / "pose-point-cloud-db-recording" / "scenario.yaml"
# A cluster is a file; one whose image is called `broken` cannot be made.
KIND = """#!{python}
import pathlib, sys
there, words = pathlib.Path({there!r}), sys.argv[1:]
with there.with_name("words").open("a") as file:
    file.write(" ".join(words[:2]) + "\\n")
if words[:2] == ["get", "clusters"]:
    print("another", "robotkube" if there.exists() else "", sep="\\n")
elif "broken" in words:
    sys.exit('ERROR: failed to create cluster: pulling image "broken": not found')
elif words[0] == "create" and "--image" not in words and there.with_name("offline").exists():
    sys.exit('ERROR: failed to create cluster: failed to pull image "kindest/node:v1": command "docker pull" failed')
elif words[0] == "create":
    there.write_text(words[words.index("--image") + 1] if "--image" in words else "")
    pathlib.Path(words[words.index("--kubeconfig") + 1]).touch()
elif words[0] == "delete":
    there.unlink()
"""
# Its one image is the one that is named in a file.
DOCKER = """#!{python}
import pathlib, sys
if sys.argv[1:] == ["-v"]:
    print("Docker version 20.10.24")
elif sys.argv[1:3] == ["image", "inspect"]:
    file = pathlib.Path({there!r})
    sys.exit(not file.exists() or file.read_text() != sys.argv[3])
"""
Asked = Callable[[], list[str]]


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Asked:
    """What kind was asked since this was asked last, but for what there is."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, text, there in (("kind", KIND, "cluster"), ("docker", DOCKER, "image")):
        (folder / name).write_text(text.format(python=sys.executable, there=str(tmp_path / there)))
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=":")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for name in (provider.NODE_IMAGE, engines.CHOICE, WORKERS):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(KindCluster, "_ready", lambda _: True)

    def words() -> list[str]:
        file = tmp_path / "words"
        said = file.read_text().splitlines() if file.exists() else []
        file.unlink(missing_ok=True)
        return [one for one in said if one != "get clusters"]

    return words


def nodes(vehicles: int) -> Topology:
    return topology.read(SCENARIO, {"vehicles": str(vehicles)})


@pytest.mark.parametrize("version_1", [False, True])
def test_each_node_of_a_scenario_is_a_worker_with_its_labels(version_1: bool) -> None:
    document = yaml.safe_load(configuration(shared_out(nodes(2), ""), version_1))
    control, *workers = document["nodes"]
    assert control == {"role": "control-plane"}
    assert [worker["labels"] for worker in workers] == [node.labels for node in nodes(2).nodes]
    assert document["networking"] == {"podSubnet": "10.72.0.0/16", "serviceSubnet": "10.73.0.0/16"}
    assert ("kubeadmConfigPatches" in document) == version_1


def test_two_workers_are_platform_and_cloud_and_all_others() -> None:
    document = yaml.safe_load(configuration(shared_out(nodes(3), "2"), False))
    _, first, second = document["nodes"]
    assert [agent.name for agent in node_agents(first["labels"])] == ["cloud-0", "platform-0"]
    vehicles = node_agents(second["labels"])
    assert [(vehicle.name, vehicle.guest) for vehicle in vehicles] == [
        ("vehicle-00", 0),
        ("vehicle-01", 1),
        ("vehicle-02", 2),
    ]
    of_agents = {node.agent: node for node in nodes(3).nodes}
    assert all(vehicle.capabilities == set(of_agents[vehicle.name].capabilities) for vehicle in vehicles)


@pytest.mark.parametrize(
    ("wanted", "workers"),
    [
        ("1", [["platform-0", "cloud-0", "vehicle-00", "vehicle-01", "vehicle-02"]]),
        ("2", [["platform-0", "cloud-0"], ["vehicle-00", "vehicle-01", "vehicle-02"]]),
        ("3", [["platform-0", "cloud-0"], ["vehicle-00"], ["vehicle-01", "vehicle-02"]]),
        ("4", [["platform-0", "cloud-0"], ["vehicle-00"], ["vehicle-01"], ["vehicle-02"]]),
        ("", [["platform-0"], ["cloud-0"], ["vehicle-00"], ["vehicle-01"], ["vehicle-02"]]),
    ],
)
def test_nodes_of_a_scenario_are_shared_out_over_so_many_workers(wanted: str, workers: list[list[str]]) -> None:
    assert [[node.name for node in own] for own in shared_out(nodes(3), wanted)] == workers


@pytest.mark.parametrize("wanted", ["0", "5", "two", "-1"])
def test_a_number_of_workers_that_cannot_be_is_refused_with_those_that_can(wanted: str) -> None:
    with pytest.raises(
        InputError, match=rf"KIND_WORKERS={wanted}: must be a whole number from 1 to 4 for these 5 nodes"
    ):
        shared_out(nodes(3), wanted)


def test_another_number_of_workers_is_another_cluster(asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    KindCluster().up(nodes(3), ())
    monkeypatch.setenv(WORKERS, "2")
    KindCluster().up(nodes(3), ())
    assert asked() == ["create cluster", "delete cluster", "create cluster"]
    KindCluster().up(nodes(3), ())
    assert asked() == []


def test_a_cluster_is_made_once_and_anew_for_other_nodes(asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = KindCluster()
    cluster.up(nodes(1), ())
    assert asked() == ["create cluster"]
    cluster.up(nodes(1), ())
    assert asked() == []
    cluster.up(nodes(2), ())
    assert asked() == ["delete cluster", "create cluster"]
    monkeypatch.setenv(provider.NODE_IMAGE, "kindest/node:v9.9.9")
    cluster.up(nodes(2), ())
    assert asked() == ["delete cluster", "create cluster"]
    monkeypatch.setattr(KindCluster, "_ready", lambda _: False)
    cluster.up(nodes(2), ())
    assert asked() == ["delete cluster", "create cluster"]


def test_images_are_loaded_once_and_a_broken_one_is_named(asked: Asked, tmp_path: Path) -> None:
    images = [built_image(tmp_path, name) for name in ("pause", "platform")]
    cluster = KindCluster()
    for _ in range(2):
        cluster.up(nodes(1), images)
    assert asked() == ["create cluster", "load image-archive"]
    other = built_image(tmp_path, "gate", b"gate")
    cluster.up(nodes(1), [*images, other])
    assert asked() == ["load image-archive"]
    broken = built_image(tmp_path, "ros", b"ros")
    broken.archive.write_bytes(b"no archive")
    with pytest.raises(SetUpError, match=r"ros.*no OCI layout archive"):
        cluster.up(nodes(1), [*images, broken])
    assert not (cluster.work() / "images").exists()


def test_one_that_could_not_be_made_is_no_cluster(asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(provider.NODE_IMAGE, "broken")
    with pytest.raises(SetUpError, match=r'kind create cluster: ERROR: failed .* pulling image "broken": not found'):
        KindCluster().up(nodes(1), ())
    monkeypatch.delenv(provider.NODE_IMAGE)
    KindCluster().up(nodes(1), ())
    assert asked() == ["create cluster"] * 2


def test_an_image_of_nodes_that_was_built_here_is_taken(
    asked: Asked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once the engine has it, unless another one is named; the cluster is made anew for it."""
    (tmp_path / "offline").touch()
    words = (
        r'failed to pull image "kindest/node:v1".*\n.*make kind-node-image builds one, which is then taken; KIND_NODE'
    )
    with pytest.raises(SetUpError, match=words):
        KindCluster().up(nodes(1), ())
    (tmp_path / "image").write_text("localhost/robotkube-kind-node:of-other-sources")
    with pytest.raises(SetUpError, match="make kind-node-image builds one"):
        KindCluster().up(nodes(1), ())
    (tmp_path / "image").write_text(naming.reference())
    KindCluster().up(nodes(1), ())
    assert (tmp_path / "cluster").read_text() == naming.reference()
    monkeypatch.setenv(provider.NODE_IMAGE, "kindest/node:v9.9.9")
    KindCluster().up(nodes(1), ())
    assert (tmp_path / "cluster").read_text() == "kindest/node:v9.9.9"
    assert asked() == [*["create cluster"] * 3, "delete cluster", "create cluster"]


def test_one_that_somebody_else_made_is_left_alone(asked: Asked, tmp_path: Path) -> None:
    (tmp_path / "cluster").touch()
    with pytest.raises(InputError, match="robotkube is there and was not made here; take it away first: kind delete"):
        KindCluster().up(nodes(1), ())
    assert KindCluster().down() == ()
    assert asked() == []


def test_down_removes_it_with_its_files(asked: Asked) -> None:
    cluster = KindCluster()
    assert cluster.down() == ()
    cluster.up(nodes(1), ())
    assert [line.partition(" ")[0] for line in cluster.down()] == ["kind", "files"]
    assert asked() == ["create cluster", "delete cluster"]
    assert not cluster.work().exists()
    assert cluster.down() == ()
    with pytest.raises(SetUpError, match="not running: start it with make cluster CLUSTER=kind"):
        cluster.status()
