"""A node's kubelet pulls an image that nobody imported, by its digest, from a real forge with the account of nodes."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from ci.cluster.embedded.nodes import pulling
from ci.cluster.embedded.nodes.pulling import REGISTRY, host_folder, hosts_toml
from ci.publish import PULL_ACCOUNT
from robotkube.cli import main as cli
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.suites.core.image_checks import BILL_TYPE
from tests.stages.forge.installation import Installation
from tests.stages.kubernetes.lone_node import LoneNode, lone_node
from tests.stages.kubernetes.node_ways import way_to
from tests.stages.platform import probe_image
from tests.stages.waiting import until

OWN, OTHER = "own-images/own", "staging-publisher/images/own"


def test_the_file_is_where_containerd_looks_and_only_root_reads_it(tmp_path: Path) -> None:
    assert (host_folder("registry.example"), host_folder(REGISTRY)) == (
        "registry.example",
        "forge.robotkube.svc.cluster.local_3000_",
    )
    for password in ("first", "second"):
        path = pulling.allow(tmp_path, "http://10.97.0.9:3000", PULL_ACCOUNT, password)
        assert path == tmp_path / "forge.robotkube.svc.cluster.local_3000_" / "hosts.toml"
        assert path.stat().st_mode & 0o777 == 0o600
        assert path.read_text() == hosts_toml("http://10.97.0.9:3000", PULL_ACCOUNT, password)


def test_a_registry_that_speaks_tls_is_verified_by_the_authorities_beside_the_file(tmp_path: Path) -> None:
    path = pulling.allow(tmp_path, "https://10.97.0.9:3000", PULL_ACCOUNT, "first", "PEM")
    host = tomllib.loads(path.read_text())["host"]["https://10.97.0.9:3000"]
    assert (path.parent / host["ca"]).read_text() == "PEM"
    assert host["header"]["Authorization"][0].startswith("Basic ")


@pytest.fixture
def node(tmp_path: Path) -> Iterator[LoneNode]:
    with lone_node(probe_image.build(tmp_path / "lock")) as made:
        made.start_kubelet()
        yield made


def published(installation: Installation, folder: Path) -> str:
    """The digest of an image that a publisher pushed and the gate copied."""
    program = (folder / "lock" / "source" / "probe").read_bytes() + b"another layer than that which the node has"
    digest = probe_image.archive(folder / "own.tar", program, "own")
    (folder / "registry").mkdir()
    (folder / "password").write_text(installation.passwords["publisher"])
    words = ["--forge-url", installation.url, "--password-file", str(folder / "password"), "--host", REGISTRY]
    assert cli.main(["image", "push", str(folder / "own.tar"), "--registry", str(folder / "registry"), *words]) == 0
    with OciRegistry(installation.url, "gate", installation.passwords["gate"]) as gate:
        gate.copy_image(OTHER, OWN, digest, BILL_TYPE)
    return digest


@pytest.mark.toolchain
def test_a_kubelet_pulls_what_is_in_no_archive(installation: Installation, node: LoneNode, tmp_path: Path) -> None:
    reference = f"{REGISTRY}/{OWN}@{published(installation, tmp_path)}"
    elsewhere = reference.replace(OWN, OTHER)

    def has(image: str) -> bool:
        return image in node.ctr("--namespace", "k8s.io", "images", "list", "--quiet").split()

    with way_to(node.holder.pid, urlsplit(installation.url).port or 0) as port:
        pulling.allow(
            node.folders.hosts, f"http://127.0.0.1:{port}", PULL_ACCOUNT, installation.passwords[PULL_ACCOUNT]
        )
        node.run_pod("other", {"containers": [{"name": "other", "image": elsewhere}]})
        node.run_pod("own", {"containers": [{"name": "own", "image": reference}]})
        until(lambda: has(reference), "the image is pulled", 60)
        running = f'image=="{reference}"'
        until(lambda: node.ctr("--namespace", "k8s.io", "containers", "list", "--quiet", running), "it runs", 60)
        assert not has(elsewhere)  # the account may not read what was not copied
