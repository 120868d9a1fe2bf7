"""Charts and images in a real registry (the forge's)."""

import io
import json
import os
import secrets
import subprocess
import tarfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import PackedChart, pack_chart
from tests.stages import http_calls
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.programs import program

pytestmark = pytest.mark.toolchain

CONFIG_TYPE = "application/vnd.oci.image.config.v1+json"
LAYER_TYPE = "application/vnd.oci.image.layer.v1.tar"


def chart(template: str = "kind: ConfigMap\n", version: str = "0.1.0") -> PackedChart:
    metadata = {"apiVersion": "v2", "name": "app", "version": version}
    return pack_chart(
        "app", metadata, {"Chart.yaml": json.dumps(metadata).encode(), "templates/a.yaml": template.encode()}
    )


def image_archive(path: Path, layers: list[bytes], elsewhere: int = 0) -> str:
    """An image whose first `elsewhere` layers are not in its archive; its digest."""
    config = canonical_json({"architecture": "amd64", "os": "linux", "rootfs": {"type": "layers", "diff_ids": []}})
    entries = [{"mediaType": LAYER_TYPE, "digest": sha256(layer), "size": len(layer)} for layer in layers]
    described = {"mediaType": CONFIG_TYPE, "digest": sha256(config), "size": len(config)}
    kind = "application/vnd.oci.image.manifest.v1+json"
    manifest = canonical_json({"schemaVersion": 2, "mediaType": kind, "config": described, "layers": entries})
    index = canonical_json({"schemaVersion": 2, "manifests": [{"digest": sha256(manifest), "size": len(manifest)}]})
    with tarfile.open(path, "w") as tar:
        files = {f"blobs/{sha256(data).replace(':', '/')}": data for data in (config, manifest, *layers[elsewhere:])}
        for name, data in (files | {"index.json": index}).items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    return sha256(manifest)


@pytest.fixture
def organisation(forge_process: ForgeProcess) -> str:
    name = f"charts-{secrets.token_hex(4)}"
    account = (forge_process.administrator, forge_process.administrator_password)
    http_calls.post(f"{forge_process.url}/api/v1/orgs", json={"username": name}, auth=account).raise_for_status()
    return name


@pytest.fixture
def registry(forge_process: ForgeProcess) -> Iterator[OciRegistry]:
    with OciRegistry(forge_process.url, forge_process.administrator, forge_process.administrator_password) as client:
        yield client


def test_a_chart_is_found_by_tag_and_digest_and_pushed_twice_is_once(registry: OciRegistry, organisation: str) -> None:
    packed = chart()
    assert registry.push_chart(organisation, packed) == packed.digest
    assert registry.push_chart(organisation, packed) == packed.digest
    repository = f"{organisation}/app"
    assert registry.manifest_digest(repository, "0.1.0") == packed.digest
    assert registry.manifest_digest(repository, packed.digest) == packed.digest
    assert registry.list(repository) == ("0.1.0",)
    assert registry.manifest_digest(repository, "9.9.9") is None
    assert registry.list(f"{organisation}/nothing") == ()


def test_a_version_is_never_replaced(registry: OciRegistry, organisation: str) -> None:
    first = chart()
    registry.push_chart(organisation, first)
    with pytest.raises(InputError, match=rf"app:0\.1\.0 is {first.digest}.*raise `version` in Chart\.yaml"):
        registry.push_chart(organisation, chart("kind: Secret\n"))
    assert registry.manifest_digest(f"{organisation}/app", first.digest) == first.digest
    registry.push_chart(organisation, chart("kind: Secret\n", "0.1.1"))
    assert registry.list(f"{organisation}/app") == ("0.1.0", "0.1.1")


def test_helm_reads_what_was_pushed(
    registry: OciRegistry, forge_process: ForgeProcess, organisation: str, tmp_path: Path
) -> None:
    helm = program("helm")
    packed = chart("kind: ConfigMap\nmetadata: {name: '{{ .Release.Name }}'}\n")
    registry.push_chart(organisation, packed)
    host = forge_process.url.removeprefix("http://")
    environment = {**os.environ, "HOME": str(tmp_path)}
    password = forge_process.administrator_password
    login = [
        helm,
        "registry",
        "login",
        "--plain-http",
        host,
        "-u",
        forge_process.administrator,
        "--password-stdin",
    ]
    subprocess.run(login, env=environment, input=password, text=True, check=True, capture_output=True, timeout=60)
    command = [helm, "template", "r", f"oci://{host}/{organisation}/app@{packed.digest}", "--plain-http"]
    done = subprocess.run(command, env=environment, text=True, check=True, capture_output=True, timeout=60)
    assert "name: 'r'" in done.stdout


def test_images_are_streamed_and_shared_layers_sent_once(
    registry: OciRegistry, organisation: str, tmp_path: Path
) -> None:
    shared, own = os.urandom(3_000_000), os.urandom(1000)
    one = image_archive(tmp_path / "one.tar", [shared])
    two = image_archive(tmp_path / "two.tar", [shared, own])
    assert registry.push_image(f"{organisation}/one", tmp_path / "one.tar") == one
    assert registry.push_image(f"{organisation}/two", tmp_path / "two.tar", "0.1.0") == two
    assert registry.push_image(f"{organisation}/two", tmp_path / "two.tar", "0.1.0") == two
    assert registry.manifest_digest(f"{organisation}/one", one) == one
    assert registry.manifest_digest(f"{organisation}/two", "0.1.0") == two
    with pytest.raises(InputError, match="never replaced"):
        registry.push_image(f"{organisation}/two", tmp_path / "one.tar", "0.1.0")


def test_an_image_that_was_cut_from_another_is_pushed_with_the_layers_of_that(
    registry: OciRegistry, organisation: str, tmp_path: Path
) -> None:
    below, own = os.urandom(100_000), os.urandom(1000)
    image_archive(tmp_path / "ground.tar", [below, os.urandom(10)])
    digest = image_archive(tmp_path / "cut.tar", [below, own], elsewhere=1)
    with pytest.raises(InputError, match=rf"cut\.tar: has no blob {sha256(below)}; build the image again"):
        registry.push_image(f"{organisation}/cut", tmp_path / "cut.tar")
    assert registry.push_image(f"{organisation}/cut", tmp_path / "cut.tar", ground=tmp_path / "ground.tar") == digest
    assert [registry.blob(f"{organisation}/cut", sha256(one), 100_000) for one in (below, own)] == [below, own]


def test_a_wrong_account_is_told_so(forge_process: ForgeProcess, organisation: str) -> None:
    with (
        OciRegistry(forge_process.url, "nobody", "wrong") as stranger,
        pytest.raises(InputError, match="account nobody may not"),
    ):
        stranger.push_chart(organisation, chart())


def test_an_absent_registry_is_unavailable() -> None:
    with OciRegistry("http://127.0.0.1:1", "", "") as absent, pytest.raises(UnavailableError, match=r"127\.0\.0\.1:1"):
        absent.manifest_digest("a/b", "1")


@pytest.mark.parametrize("content", [b"", b"no tar"])
def test_a_file_that_is_no_archive_is_refused(
    registry: OciRegistry, organisation: str, tmp_path: Path, content: bytes
) -> None:
    (tmp_path / "image.tar").write_bytes(content)
    with pytest.raises(InputError, match=r"image\.tar"):
        registry.push_image(f"{organisation}/x", tmp_path / "image.tar")
