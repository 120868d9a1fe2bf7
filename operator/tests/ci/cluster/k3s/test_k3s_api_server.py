"""`k3s` on a real API server, with Nodes that say of themselves what Nodes of k3s say: what is refused has changed
nothing, images are brought by a file, and then every object and file is as before."""

from __future__ import annotations

import json
import tarfile
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci.client_certificates import client_certificate
from ci.cluster import __main__ as commands
from ci.cluster.existing.nodes import GivenCluster
from ci.cluster.existing.provider import ADDED
from ci.cluster.k3s import archives, nodes
from ci.cluster.k3s.provider import K3s
from ci.cluster_contract.topology import NodeSpec, Topology
from ci.errors import InputError, SetUpError
from ci.images.image_lock import Image
from robotkube.registry.bundles.adapters.loading import CONTAINERD_NAME
from tests.stages.kubernetes.api_calls import Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.registry.built_images import built_image

pytestmark = pytest.mark.toolchain

AGENTS = {"k3s-server": ("platform", "platform"), "k3s-1": ("cloud", "cloud-0"), "k3s-2": ("vehicle", "vehicle-00")}
TOPOLOGY = Topology(tuple(NodeSpec(agent, role, agent, 1000, 1 << 30, ()) for role, agent in AGENTS.values()))
SLICES = "/apis/discovery.k8s.io/v1/namespaces/default/endpointslices"
CLASSES = "/apis/storage.k8s.io/v1/storageclasses"
PLATFORM = "/api/v1/namespaces/robotkube"


@pytest.fixture
def api(api_server: ApiServerProcess, api: Api) -> Iterator[Api]:
    """A server and two agents, as k3s registers them, and what it brings."""
    for number, name in enumerate(AGENTS):
        metadata, spec = {"name": name}, {"podCIDRs": [f"10.42.{number}.0/24"], "podCIDR": f"10.42.{number}.0/24"}
        api.post("/api/v1/nodes", {"apiVersion": "v1", "kind": "Node", "metadata": metadata, "spec": spec})
        say(api, name, address=f"192.0.2.1{number}")
    endpoint = {"addresses": ["192.0.2.10"], "conditions": {"ready": True}}
    labels = {"kubernetes.io/service-name": "kubernetes"}
    slices = {"addressType": "IPv4", "endpoints": [endpoint], "ports": [{"name": "https", "port": 6443}]}
    api.post(SLICES, {"kind": "EndpointSlice", "metadata": {"name": "kubernetes", "labels": labels}, **slices})
    api.post(CLASSES, {"metadata": {"name": "local-path"}, "provisioner": "rancher.io/local-path"})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield api
    for path in (*(f"/api/v1/nodes/{name}" for name in AGENTS), f"{SLICES}/kubernetes"):
        api.delete(path)
    for one in api.get(CLASSES)["items"]:
        api.delete(f"{CLASSES}/{one['metadata']['name']}")


def say(
    api: Api,
    name: str,
    address: str = "192.0.2.10",
    version: str = "v1.34.1+k3s1",
    boot: str | None = None,
    images: Sequence[str] = (),
) -> None:
    """Have a Node say this of itself, by itself of this machine."""
    info = dict.fromkeys(
        ("machineID", "systemUUID", "kernelVersion", "osImage", "containerRuntimeVersion", "kubeProxyVersion"), ""
    )
    info |= {"operatingSystem": "linux", "architecture": "amd64", "kubeletVersion": version}
    info |= {"bootID": nodes.this_boot() if boot is None else boot}
    status: dict[str, Any] = {"nodeInfo": info, "addresses": [{"type": "InternalIP", "address": address}]}
    status["images"] = [{"names": [image], "sizeBytes": 1} for image in images]
    api.merge(f"/api/v1/nodes/{name}/status", {"status": status})


@pytest.fixture
def given(api_server: ApiServerProcess, api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> GivenCluster:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv(archives.VARIABLE, str(tmp_path / "images"))
    (tmp_path / "images").mkdir()
    entries = [{"node": node, "role": role, "agent": agent} for node, (role, agent) in AGENTS.items()]
    (tmp_path / "agents.yaml").write_text(yaml.safe_dump({"agents": entries}))
    return GivenCluster(str(api_server.kubeconfig), agents=tmp_path / "agents.yaml", agreed=True)


@pytest.fixture
def images(tmp_path: Path) -> list[Image]:
    return [built_image(tmp_path / "built", name) for name in ("pause", "platform")]


def everything(api: Api) -> Mapping[str, Any]:
    """Nodes without what counts their versions and what they say themselves, and namespaces."""
    objects = {}
    for kind in ("nodes", "namespaces"):
        for item in api.get(f"/api/v1/{kind}")["items"]:
            for key in ("resourceVersion", "managedFields"):
                item["metadata"].pop(key, None)
            item.pop("status")
            objects[f"{kind}/{item['metadata']['name']}"] = item
    return objects


@contextmanager
def begun(api: Api) -> Iterator[None]:
    """An installation has begun: nothing of it has to be agreed to any more."""
    api.merge(PLATFORM, {"metadata": {"annotations": ADDED}})
    try:
        yield
    finally:
        api.merge(PLATFORM, {"metadata": {"annotations": None}})


@contextmanager
def importing(api: Api, folder: Path) -> Iterator[None]:
    """What k3s does with its folder of images: each Node has what the archives there name, and says so."""
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(0.05):
            for file in folder.glob("*.tar"):
                for name in AGENTS:
                    say(api, name, images=names_in(file))
                return

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def names_in(archive: Path) -> list[str]:
    with tarfile.open(archive) as tar:
        index = json.load(tar.extractfile("index.json"))  # type: ignore[arg-type]
    return [entry["annotations"][CONTAINERD_NAME] for entry in index["manifests"]]


def test_nodes_are_taken_with_values_of_the_cluster_and_given_back(
    api: Api, given: GivenCluster, capsys: pytest.CaptureFixture[str]
) -> None:
    before = everything(api)
    words = ["--cluster", "k3s", "--kubeconfig", given.kubeconfig, "--agents", str(given.agents), "--yes"]
    commands.run(commands.arguments().parse_args(["up", "--dry-run", *words]))
    assert "Node k3s-1: label robotkube.io/role = cloud" in capsys.readouterr().out
    assert everything(api) == before
    commands.run(commands.arguments().parse_args(["up", *words]))
    said = capsys.readouterr().out
    assert "3 Nodes changed" in said
    assert "not given: what publishers push to the forge is not pulled by Nodes" in said
    values = yaml.safe_load(Path(said.splitlines()[-1].partition(": ")[2]).read_text())
    assert values["storage"] == {"className": "local-path"}
    server = [{"ipBlock": {"cidr": one}} for one in ("192.0.2.10/32", "10.42.0.0/31")]
    assert values["networkPolicies"]["apiServer"] == {"to": server, "ports": [6443]}
    assert len(values["networkPolicies"]["kubelets"]["to"]) == 3
    commands.run(commands.arguments().parse_args(["down", *words]))
    assert "kept: images that Nodes have pulled or imported" in capsys.readouterr().out
    assert everything(api) == before


@pytest.mark.parametrize("version", ["v1.34.1", "v1.34.1+rke2r1"])
def test_nodes_of_others_are_refused_with_the_kind_that_takes_them(api: Api, given: GivenCluster, version: str) -> None:
    say(api, "k3s-1", version=version)
    before = everything(api)
    for act in (K3s(given).take, K3s(given).planned, lambda: K3s(given).up(TOPOLOGY, ())):
        with pytest.raises(InputError, match=r"these have not: k3s-1 \(v1\.34\.1.*\); CLUSTER=existing takes Nodes"):
            act()
    assert everything(api) == before


def test_without_its_storage_another_class_has_to_be_named(api: Api, given: GivenCluster, tmp_path: Path) -> None:
    api.delete(f"{CLASSES}/local-path")
    api.post(CLASSES, {"metadata": {"name": "longhorn"}, "provisioner": "example.com/longhorn"})
    before = everything(api)
    with pytest.raises(
        InputError, match=r"StorageClass local-path is not there.* there is: longhorn\. Name one by VAL"
    ):
        K3s(given).take()
    assert everything(api) == before
    (tmp_path / "values.yaml").write_text("storage: {className: longhorn}\n")
    cluster = K3s(replace(given, values=tmp_path / "values.yaml"))
    cluster.take()
    assert yaml.safe_load(cluster.values_file.read_text())["storage"] == {"className": "longhorn"}
    cluster.down()


def test_images_are_a_file_that_is_agreed_to_and_goes_again(
    api: Api, given: GivenCluster, images: list[Image], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archives, "POLL_SECONDS", 0.05)
    before = everything(api)
    asked = []

    def yes(question: str) -> bool:
        asked.append(question)
        assert not list((tmp_path / "images").iterdir())
        return True

    cluster = K3s(replace(given, agreed=False), yes)
    with begun(api), importing(api, tmp_path / "images"):
        cluster.up(TOPOLOGY, images)
        cluster.up(TOPOLOGY, images)
    [question] = asked
    [file] = (tmp_path / "images").iterdir()
    assert f"file {file}: all images, which k3s imports" in question
    assert sorted(names_in(file)) == sorted(image.reference for image in images)
    with begun(api):
        profile = cluster.chart_profile()
        assert profile.registry == ""
        assert "global" not in profile.values
    with pytest.raises(InputError, match="nothing was written, since nobody agreed"):
        K3s(replace(given, agreed=False), lambda _: False).down()
    assert file.exists()
    assert f"file {file}" in K3s(given).down()
    assert not file.exists()
    assert everything(api) == before
    assert cluster.down() == ()


def test_what_k3s_does_not_import_ends_the_start(
    api: Api, given: GivenCluster, images: list[Image], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archives, "IMPORT_SECONDS_MAX", 0.02)
    monkeypatch.setattr(archives, "POLL_SECONDS", 0.01)
    cluster = K3s(given)
    with begun(api), pytest.raises(SetUpError, match=r"Node k3s-1 .*: has not .*sha256.*2 of 2 images.*look into the"):
        cluster.up(TOPOLOGY, images)
    assert len(cluster.brought()) == 1
    cluster.down()
    assert cluster.brought() == ()


def test_for_other_machines_a_registry_is_needed_and_their_files_stay_theirs(
    api: Api, given: GivenCluster, images: list[Image], tmp_path: Path
) -> None:
    say(api, "k3s-2", boot="another")
    (tmp_path / "images" / "robotkube-demo-0.tar").touch()  # of another k3s, on this machine
    before = everything(api)
    with begun(api), pytest.raises(InputError, match=r"REGISTRY=HOST/PATH is needed: k3s-2 are other machines"):
        K3s(given).up(TOPOLOGY, images)
    assert everything(api) == before
    assert K3s(given).down() == ()
    assert (tmp_path / "images" / "robotkube-demo-0.tar").exists()


def test_with_a_registry_each_node_has_a_text_to_be_given(
    api: Api, given: GivenCluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    say(api, "k3s-2", boot="another")
    (tmp_path / "ca.pem").write_text(client_certificate("registry").certificate)
    cluster = K3s(replace(given, registry="registry.example.com/r", authority=tmp_path / "ca.pem"))
    with begun(api):
        cluster.up(TOPOLOGY, ())
    assert f"{cluster.registries_file} is for each Node's /etc/rancher/k3s/registries.yaml" in capsys.readouterr().err
    assert yaml.safe_load(cluster.registries_file.read_text())["configs"]["registry.example.com"]["tls"]
    assert cluster.authority_file.read_text() == (tmp_path / "ca.pem").read_text()
    assert str(cluster.registries_file) in cluster.lacks[0]
    assert cluster.chart_profile().registry == "registry.example.com/r"
    assert not list((tmp_path / "images").iterdir())
    cluster.down()
    assert not cluster.registries_file.exists()
    assert not cluster.authority_file.exists()
