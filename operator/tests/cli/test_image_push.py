"""`robotkube image push` to a real forge: image and bill in the publisher's place, the reference where charts are
packed with it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli import main as cli
from robotkube.errors import InputError
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.publication.adapters.submission_folders import read_images
from robotkube.registry.suites.core.image_checks import BILL_TYPE, ImageReference, read_reference
from tests.stages.forge.installation import Installation
from tests.stages.programs import program
from tests.stages.registry.made_archives import write_archive
from tests.stages.registry.made_layers import COMPRESSIONS, FILES, made_layer
from tests.stages.registry.publications import write_sources

pytestmark = pytest.mark.toolchain

HOST = "forge.robotkube.svc.cluster.local:3000"
CHART = "greeter"


class Publisher:
    """The commands of somebody with the account `publisher`, in the sources of one new application."""

    def __init__(self, installation: Installation, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.url = installation.url
        self.folder = folder
        self._capsys = capsys
        self._password = folder / "password"
        self._password.write_text(installation.passwords["publisher"])
        write_sources(folder, CHART)
        self.chart = folder / "charts" / "apps" / CHART
        self.said = ""

    def run(self, *words: str, code: int = 0) -> dict[str, Any]:
        """The command's data."""
        self._capsys.readouterr()
        access = ["--forge-url", self.url, "--password-file", str(self._password), "-o", "json"]
        ended = cli.main([*words, *access])
        captured = self._capsys.readouterr()
        self.said = captured.err
        assert ended == code, captured
        return json.loads(captured.out) if captured.out else {}

    def push(self, source: Path, *more: str) -> dict[str, Any]:
        row: dict[str, Any] = self.run("image", "push", str(source), "--host", HOST, *more)["images"][0]
        return row

    def name_image(self) -> None:
        """Have the chart run the image of its name, as its README says."""
        for path, old in (
            (self.chart / "Chart.yaml", "robotkube.io/images: ros"),
            (self.chart / "templates" / "_app.tpl", "image: ros"),
            (self.folder / "registry" / "charts" / CHART / "0.1.0.yaml", "images: [ros]"),
        ):
            text = path.read_text()
            assert old in text
            path.write_text(text.replace(old, old.replace("ros", CHART)))


@pytest.fixture
def publisher(
    installation: Installation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Publisher:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("ROBOTKUBE_HELM", program("helm"))
    return Publisher(installation, tmp_path, capsys)


@pytest.fixture
def registry(installation: Installation) -> Iterator[OciRegistry]:
    with OciRegistry(installation.url, "publisher", installation.passwords["publisher"]) as opened:
        yield opened


def bills_of(registry: OciRegistry, reference: ImageReference) -> list[bytes]:
    pushed = reference.repository.replace("own-images/", "staging-publisher/images/")
    attached = registry.attachments(pushed, reference.digest)
    return [one.data for one in attached if one.artifact_type == BILL_TYPE]


def test_a_charts_image_is_pushed_named_and_tried(publisher: Publisher, registry: OciRegistry) -> None:
    row = publisher.push(publisher.chart, "--base", "scratch")
    assert f"chart {CHART} does not run image {CHART} yet; name it in `robotkube.io/images`" in publisher.said
    images = publisher.folder / "registry" / "images.yaml"
    assert row["written"] == str(images)
    assert read_images(images) == {CHART: row["reference"]}
    reference = read_reference(row["reference"])
    assert reference is not None
    assert (reference.host, reference.repository) == (HOST, f"own-images/{CHART}")
    assert len(bills_of(registry, reference)) == 1
    publisher.name_image()
    before = images.stat().st_mtime_ns
    assert publisher.push(publisher.chart, "--base", "scratch") == row
    assert "does not run" not in publisher.said
    assert images.stat().st_mtime_ns == before
    assert len(bills_of(registry, reference)) == 1
    assert cli.main(["registry", "validate", "--registry", str(images.parent)]) == 0
    rows = publisher.run("registry", "try", str(publisher.chart))["suites"]
    assert {one["suite"]: one["outcome"] for one in rows if one["suite"] in ("static", "images")} == {
        "static": "passed",
        "images": "passed",
    }


@pytest.mark.parametrize("compression", ["gzip", "zstd"])
def test_an_archive_of_another_builder_is_pushed_as_it_is(
    publisher: Publisher, registry: OciRegistry, compression: str
) -> None:
    archive = publisher.folder / f"other-{compression}.tar"
    digest = write_archive(archive, [COMPRESSIONS[compression](made_layer(FILES))])
    images = publisher.folder / "registry" / "images.yaml"
    images.write_text(f"# kept\n{CHART}: h/r@sha256:{'0' * 64}\nother-{compression}: h/r@sha256:{'1' * 64}\n")
    row = publisher.push(archive, "--registry", str(images.parent))
    assert row["digest"] == digest
    assert images.read_text() == (f"# kept\n{CHART}: h/r@sha256:{'0' * 64}\nother-{compression}: {row['reference']}\n")
    reference = read_reference(row["reference"])
    assert reference is not None
    assert len(bills_of(registry, reference)) == 1


def test_another_account_cannot_push_there(publisher: Publisher) -> None:
    write_archive(publisher.folder / "other.tar", [made_layer(FILES)])
    publisher._password.write_text("wrong")
    where = ["--registry", str(publisher.folder / "registry"), "--host", HOST]
    publisher.run("image", "push", str(publisher.folder / "other.tar"), *where, code=2)
    assert "account publisher may not do this" in publisher.said


def test_the_gate_copies_it_to_where_nodes_pull_and_nobody_else_writes(
    publisher: Publisher, registry: OciRegistry, installation: Installation
) -> None:
    write_archive(publisher.folder / "copied.tar", [COMPRESSIONS["gzip"](made_layer(FILES))])
    row = publisher.push(publisher.folder / "copied.tar", "--registry", str(publisher.folder / "registry"))
    source = "staging-publisher/images/copied"
    target = "own-images/copied"
    digest = row["digest"]
    registry.attach(source, digest, "text/plain", b"something else", {})
    gate, nodes = (OciRegistry(installation.url, name, installation.passwords[name]) for name in ("gate", "nodes"))
    with gate, nodes:
        for _ in range(2):
            gate.copy_image(source, target, digest, BILL_TYPE)
        manifest = json.loads(nodes.manifest(target, digest))
        for blob in (manifest["config"], *manifest["layers"]):
            assert nodes.blob(target, blob["digest"], blob["size"])
        assert [attachment.artifact_type for attachment in gate.attachments(target, digest)] == [BILL_TYPE]
        with pytest.raises(InputError, match=f"has no manifest sha256:{'0' * 64}"):
            gate.copy_image(source, target, f"sha256:{'0' * 64}", BILL_TYPE)
        for account, place in ((nodes, target), (nodes, source), (registry, target)):
            with pytest.raises(InputError, match="may not do this"):
                account.push_image(place, publisher.folder / "copied.tar", tag="0.1.0")
        with pytest.raises(InputError, match="may not do this"):
            nodes.remove_image(target, digest)
        for _ in range(2):
            gate.remove_image(target, digest)
        assert gate.manifest_digest(target, digest) is None
        assert gate.attachments(target, digest) == []
        assert registry.manifest_digest(source, digest) == digest
        assert len(registry.attachments(source, digest)) == 2
        gate.copy_image(source, target, digest, BILL_TYPE)
        for blob in (manifest["config"], *manifest["layers"]):
            assert nodes.blob(target, blob["digest"], blob["size"])
