"""What is known of a k3s before it is asked: its kubeconfig, its Nodes, what its network and its registries are told,
and the folder from which it imports."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci.cluster.existing.nodes import GivenCluster
from ci.cluster.k3s import archives, nodes, provider
from ci.cluster.k3s.nodes import K3sNode
from ci.cluster.k3s.registries import AUTHORITY, registries
from ci.cluster.k3s.values import chart_values
from ci.errors import InputError, SetUpError
from ci.images.built import REPOSITORY
from robotkube.registry.bundles.core.places import RegistryPlace
from tests.stages.registry.built_images import built_image

VERSION = "v1.34.1+k3s1"
SERVER = K3sNode("server", "192.0.2.10", VERSION, "boot", ("10.42.0.0/24",))
AGENT = K3sNode("agent", "192.0.2.11", VERSION, "boot", ("10.42.1.0/24",))
HERE = {("192.0.2.10", 6443)}
PLACE = RegistryPlace("registry.example.com:5000", "robots/fleet")


@pytest.fixture(autouse=True)
def nothing_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("KUBECONFIG", archives.VARIABLE):
        monkeypatch.delenv(name, raising=False)


def cidrs(peers: Sequence[Mapping[str, Any]]) -> list[str]:
    return [peer["ipBlock"]["cidr"] for peer in peers]


class TestKubeconfig:
    def test_its_own_is_taken_where_nobody_names_one(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        own = tmp_path / "k3s.yaml"
        own.write_text("apiVersion: v1\n")
        monkeypatch.setattr(provider, "KUBECONFIG", own)
        assert provider.kubeconfig_of(GivenCluster()) == str(own)
        assert provider.kubeconfig_of(GivenCluster("mine")) == "mine"
        monkeypatch.setenv("KUBECONFIG", "other")
        assert provider.kubeconfig_of(GivenCluster()) == "", "kubectl and its library read the variable themselves"

    def test_one_that_is_not_there_or_cannot_be_read_is_named_with_the_way_out(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(provider, "KUBECONFIG", tmp_path / "k3s.yaml")
        with pytest.raises(InputError, match=r"k3s\.yaml: is not there, so no server .*: KUBECONFIG=FILE"):
            provider.kubeconfig_of(GivenCluster())
        (tmp_path / "k3s.yaml").mkdir()
        with pytest.raises(InputError, match=r"k3s\.yaml: cannot be read \(Is a directory\); run this as root"):
            provider.kubeconfig_of(GivenCluster())


class TestNodes:
    def test_what_a_node_says(self) -> None:
        item = {
            "metadata": {"name": "server"},
            "spec": {"podCIDRs": ["10.42.0.0/24"]},
            "status": {
                "addresses": [
                    {"type": "InternalIP", "address": "192.0.2.10"},
                    {"type": "InternalIP", "address": "2001:db8::a"},
                    {"type": "Hostname", "address": "server"},
                ],
                "nodeInfo": {"kubeletVersion": VERSION, "bootID": "boot"},
                "images": [{"names": ["a/b@sha256:1", "a/b:1"]}],
            },
        }
        node = nodes.read(item)
        assert node == K3sNode(
            "server", "192.0.2.10", VERSION, "boot", ("10.42.0.0/24",), frozenset({"a/b@sha256:1", "a/b:1"})
        )
        assert node.is_k3s
        assert node.lacking(["a/b@sha256:1", "a/c@sha256:2"]) == ["a/c@sha256:2"]

    @pytest.mark.parametrize("version", ["v1.34.1", "v1.34.1+rke2r1", ""])
    def test_kubelets_of_others(self, version: str) -> None:
        assert not nodes.read({"metadata": {"name": "n"}, "status": {"nodeInfo": {"kubeletVersion": version}}}).is_k3s

    def test_of_one_that_does_not_list_all_its_images_nothing_is_surely_missing(self) -> None:
        images = [{"names": [f"a/{number}:1"]} for number in range(nodes.LISTED_IMAGES_MAX)]
        item: dict[str, Any] = {"metadata": {"name": "n"}, "status": {"images": images}}
        assert nodes.read(item).lacking(["a/b:1"]) == []
        images.pop()
        assert nodes.read(item).lacking(["a/b:1"]) == ["a/b:1"]


class TestChartValues:
    def test_policies_know_api_server_and_kubelets(self) -> None:
        policies = chart_values([SERVER, AGENT], HERE, {"local-path"})["networkPolicies"]
        assert policies["apiServer"]["ports"] == [6443]
        assert cidrs(policies["kubelets"]["to"]) == ["192.0.2.10/32", "192.0.2.11/32"]

    def test_a_server_reaches_pods_of_other_nodes_by_its_addresses_in_the_range_of_pods(self) -> None:
        """Those of flannel and of the bridge; no pod has them."""
        server = K3sNode("s", "2001:db8::a", VERSION, "boot", ("10.42.0.0/24", "2001:db8:42::/64"))
        policies = chart_values([server, AGENT], {("2001:db8::a", 6443)}, ())["networkPolicies"]
        assert cidrs(policies["apiServer"]["to"]) == ["2001:db8::a/128", "10.42.0.0/31", "2001:db8:42::/127"]

    def test_storage_is_what_k3s_brings_where_it_is_there(self) -> None:
        assert chart_values([SERVER], HERE, {"local-path", "longhorn"})["storage"] == {"className": "local-path"}
        assert "storage" not in chart_values([SERVER], HERE, {"longhorn"})

    def test_what_is_not_known_is_left_to_the_chart(self) -> None:
        assert chart_values([K3sNode("n", "", VERSION, "boot")], (), ()) == {"networkPolicies": {}}


class TestRegistries:
    def test_names_of_application_charts_lead_to_where_the_bundle_is(self) -> None:
        document = yaml.safe_load(registries(PLACE, with_authority=False))
        host, _, name = f"{REPOSITORY}/ros".partition("/")
        mirror = document["mirrors"][host]
        [(pattern, new)] = mirror["rewrite"].items()
        assert mirror["endpoint"] == ["https://registry.example.com:5000"]
        assert re.sub(pattern, new.replace("$1", r"\1"), name) == f"{PLACE.path}/ros"
        assert "configs" not in document

    def test_an_authority_of_ones_own(self) -> None:
        text = registries(PLACE, with_authority=True)
        assert yaml.safe_load(text)["configs"] == {PLACE.host: {"tls": {"ca_file": AUTHORITY}}}
        assert f"below configs: {PLACE.host}: {{auth: {{username: ..., password: ...}}}}" in text


class TestArchives:
    def test_other_images_are_another_file(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv(archives.VARIABLE, str(tmp_path))
        images = [built_image(tmp_path, name) for name in ("pause", "platform")]
        first = archives.archive(images)
        assert first == archives.archive(images[::-1])
        assert first.parent == tmp_path
        assert re.fullmatch(r"robotkube-demo-[0-9a-f]{12}\.tar", first.name)
        assert archives.archive(images[:1]) != first

    def test_they_are_there_whole_and_earlier_ones_go(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv(archives.VARIABLE, str(tmp_path))
        bundle = tmp_path / "robotkube-0.1.0.tar"  # a person put it there
        bundle.touch()
        work = tmp_path / "work"
        image = built_image(tmp_path, "platform")
        there = K3sNode("n", "", VERSION, "boot", images=frozenset({image.reference}))
        archives.bring([image], work, lambda: [there])
        [first] = archives.archives()
        made = first.stat().st_mtime_ns
        archives.bring([image], work, lambda: [there])
        assert first.stat().st_mtime_ns == made
        (tmp_path / "robotkube-demo-0.tar.part").touch()  # of a run that was killed
        other = built_image(tmp_path, "platform", b"another")
        archives.bring([other], work, lambda: [K3sNode("n", "", VERSION, "", images=None)])
        assert archives.archives() == (archives.archive([other]),) != (first,)
        assert bundle.exists()
        assert not work.exists()

    def test_a_node_that_imports_nothing_is_named_with_what_may_help(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv(archives.VARIABLE, str(tmp_path))
        monkeypatch.setattr(archives, "IMPORT_SECONDS_MAX", 0.02)
        monkeypatch.setattr(archives, "POLL_SECONDS", 0.01)
        image = built_image(tmp_path, "platform")
        with pytest.raises(
            SetUpError, match=r"Node server \(v1\.34\.1\+k3s1\): has not .*/platform@sha256:.* \(1 of 1"
        ):
            archives.bring([image], tmp_path / "work", lambda: [SERVER])

    @pytest.mark.parametrize("there", ["nowhere", "file"])
    def test_a_folder_that_is_none(self, there: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "file").touch(mode=0o755)
        monkeypatch.setenv(archives.VARIABLE, str(tmp_path / there))
        with pytest.raises(InputError, match=rf"K3S_IMAGES=.*/{there}: is no folder that this process can write to"):
            archives.folder()
        assert archives.archives() == ()

    def test_who_cannot_look_says_that_something_may_stay(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv(archives.VARIABLE, str(tmp_path / "images"))
        monkeypatch.setattr(archives.os, "geteuid", lambda: 1000)
        assert (
            archives.hidden()
            == f"{tmp_path}/images/robotkube-demo-*.tar, if root put one there: this process may not look"
        )
        (tmp_path / "images").mkdir()
        assert archives.hidden() == ""

    def test_one_that_takes_no_file(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """As root every folder seems writable; the kernel's takes nothing."""
        monkeypatch.setattr(archives, "archive", lambda _: Path("/proc/robotkube-demo-0.tar"))
        with pytest.raises(SetUpError, match=r"/proc/robotkube-demo-0\.tar: cannot be written: "):
            archives.bring([built_image(tmp_path, "platform")], tmp_path / "work", lambda: [])
