"""`robotkube image build`: real builds on nothing and on a base image that comes from an OCI registry."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli import main as cli
from robotkube.errors import InputError
from robotkube.registry.charts.adapters.oci import read_layout
from robotkube.registry.images.adapters.base_images import fetch_base, local_tag
from robotkube.registry.images.adapters.docker import take_apart
from robotkube.registry.images.adapters.engines import choose_engine
from robotkube.registry.images.adapters.normalising import normalise_image
from robotkube.registry.images.adapters.own_images import OwnImage, build_image
from robotkube.registry.suites.adapters.image_layers import read_layer
from robotkube.registry.suites.core.bill_comparison import differences
from robotkube.registry.suites.core.image_checks import ImageReference, bill_problems, label_problems, user_problems
from robotkube.registry.suites.core.image_contents import contents_of
from tests.stages.registry.made_layers import COMPRESSIONS, FILES, made_layer
from tests.stages.registry.own_image_sources import DOCKERFILE, write_folder

pytestmark = pytest.mark.processes


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("kubernetes.config.kube_config.KUBE_CONFIG_DEFAULT_LOCATION", "/nowhere/kubeconfig")
    monkeypatch.delenv("KUBECONFIG", raising=False)
    return tmp_path / "cache" / "robotkube" / "own-images"


def blob(archive: Path, digest: str) -> bytes:
    return b"".join(read_layout(archive)[0][digest].chunks())


def layers_of(archive: Path) -> list[bytes]:
    manifest = json.loads(blob(archive, read_layout(archive)[1]))
    return [blob(archive, layer["digest"]) for layer in manifest["layers"]]


def test_two_checkouts_give_one_digest_and_one_bill(
    cache: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = []
    for name, mode, seconds in (("one", 0o644, 0), ("other", 0o600, 1_000_000_000)):
        folder = write_folder(tmp_path / name / "own", mode=mode, seconds=seconds)
        words = ["--archive", str(tmp_path / name / "image.tar"), "-o", "json"]
        assert cli.main(["image", "build", str(folder), *words]) == 0
        captured = capsys.readouterr()
        assert captured.err == f"robotkube: buildah builds {folder}/Dockerfile\n"
        rows += json.loads(captured.out)["images"]
    assert rows[0]["digest"] == rows[1]["digest"]
    assert (rows[0]["image"], rows[0]["engine"]) == ("own", "buildah")
    bills = [Path(row["bill"]).read_bytes() for row in rows]
    assert bills[0] == bills[1]
    image = contents_of(read_layer(iter([layer])) for layer in layers_of(tmp_path / "one" / "image.tar"))
    assert image.elf.keys() == {"/usr/bin/tool"}
    assert list(bill_problems(bills[0], rows[0]["digest"])) == []
    assert list(differences(json.loads(bills[0]), image)) == []
    manifest = json.loads(blob(tmp_path / "one" / "image.tar", rows[0]["digest"]))
    settings = json.loads(blob(tmp_path / "one" / "image.tar", manifest["config"]["digest"]))["config"]
    assert settings["Entrypoint"] == ["/usr/bin/tool"]
    assert [*user_problems("own", settings), *label_problems("own", settings)] == []


def test_the_archive_is_kept_in_the_cache_until_the_next_build(cache: Path, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "own")
    assert cli.main(["image", "build", str(folder)]) == 0
    first = read_layout(cache / "own.tar")[1]
    (folder / "files" / "answers.py").write_text("ANSWER = 43\n")
    assert cli.main(["image", "build", str(folder)]) == 0
    assert read_layout(cache / "own.tar")[1] != first
    assert sorted(path.name for path in cache.iterdir()) == ["engine", "own.tar", "own.tar.bill.json"]


def test_what_is_wrong_is_said(cache: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def said(*words: str) -> str:
        assert cli.main(["image", "build", *words]) == 2
        return capsys.readouterr().err

    assert f"{tmp_path}/Dockerfile: missing; name the folder that has it" in said(str(tmp_path))
    folder = write_folder(tmp_path / "own", DOCKERFILE + "COPY absent /\n")
    assert "image name 'Own': use lower-case letters" in said(str(folder), "--name", "Own")
    assert "absent" in said(str(folder))
    (folder / "Dockerfile").write_text("ARG BASE\nFROM ${BASE}\n")
    assert "leaves BASE open, and no platform is reached by the default kubeconfig" in said(str(folder))
    assert "give an image with --base" in said(str(folder))


class Archived:
    """An OCI registry that has the images of one archive."""

    def __init__(self, archive: Path) -> None:
        self.archive = archive

    def manifest(self, repository: str, digest: str) -> bytes:
        return blob(self.archive, digest)

    def blob_pieces(self, repository: str, digest: str, bytes_max: int) -> Iterator[bytes]:
        yield blob(self.archive, digest)


def test_an_image_stands_on_a_base_from_the_registry(tmp_path: Path) -> None:
    digest = normal_of(tmp_path / "ros", made_layer(FILES))
    reference = ImageReference("forge.invalid:3000", "robotkube/ros", digest)
    tag = local_tag(reference)
    engine = choose_engine(tmp_path / "engine", "buildah")
    assert not engine.has(tag)
    fetch_base(Archived(tmp_path / "ros.tar"), reference, "linux/amd64", tmp_path / "base.tar")
    engine.load(tmp_path / "base.tar", tag)
    assert engine.has(tag)
    folder = write_folder(tmp_path / "own", DOCKERFILE.replace("FROM scratch", "ARG BASE\nFROM ${BASE}"))
    built: OwnImage = build_image(folder, "own", tmp_path / "own.tar", engine, {"BASE": tag})
    layers = layers_of(built.archive)
    assert layers[0] == layers_of(tmp_path / "ros.tar")[0]  # byte by byte, so the registry has it already
    image = contents_of(read_layer(iter([layer])) for layer in layers)
    assert {"/opt/own/answers.py", "/usr/lib/libx.so.1"} <= image.files.keys()


def test_a_base_that_is_no_image_is_refused(tmp_path: Path) -> None:
    class Other(Archived):
        def manifest(self, repository: str, digest: str) -> bytes:
            return b'{"manifests": []}' if digest.endswith("1") else b"[]"

    for end, words in (("1", "is not built for linux/amd64"), ("2", "is neither the manifest of an image")):
        reference = ImageReference("forge.invalid:3000", "robotkube/ros", f"sha256:{end * 64}")
        with pytest.raises(InputError, match=words):
            fetch_base(Other(tmp_path), reference, "linux/amd64", tmp_path / "base.tar")


def normal_of(folder: Path, layer: bytes) -> str:
    """The normal form, in `folder`.tar, of an image that docker saved with this layer; its digest."""
    config = json.dumps({"architecture": "amd64", "os": "linux", "config": {}}).encode()
    files = {"c.json": config, "one/layer.tar": layer}
    files["manifest.json"] = json.dumps([{"Config": "c.json", "Layers": ["one/layer.tar"]}]).encode()
    folder.mkdir()
    _write_tar(folder / "saved.tar", files)
    take_apart(folder / "saved.tar", folder)
    return normalise_image(folder, folder.with_suffix(".tar"), "own").digest


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_what_docker_saves_has_the_same_normal_form(tmp_path: Path, compression: str) -> None:
    """docker writes paths of its own, and compresses layers or not, depending on its image store."""
    plain = made_layer(FILES)
    assert normal_of(tmp_path / "plain", plain) == normal_of(tmp_path / "saved", COMPRESSIONS[compression](plain))


def _write_tar(path: Path, files: dict[str, Any]) -> None:
    with tarfile.open(path, "w") as tar:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
