"""Charts: the same files, the same digest; what cannot be packed is refused with file and fix."""

import gzip
import io
import json
import os
import shutil
import tarfile
from pathlib import Path

import pytest

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.core.packing import build_tag, entry_digest, pack_chart

IMAGES = {"ros": "host/ros@sha256:1", "platform": "host/platform@sha256:2"}


@pytest.fixture
def chart(tmp_path: Path) -> Path:
    folder = tmp_path / "app"
    (folder / "templates").mkdir(parents=True)
    dependency = "dependencies:\n- {name: shared, version: 0.1.0, repository: 'file://../shared'}\n"
    (folder / "Chart.yaml").write_text(f"apiVersion: v2\nname: app\nversion: 0.1.0\n{dependency}")
    (folder / "templates" / "object.yaml").write_text("kind: ConfigMap\n")
    (folder / "README.md").write_text("read\n")
    (folder / ".helmignore").write_text("README.md\n")
    shared = tmp_path / "shared"
    (shared / "templates").mkdir(parents=True)
    (shared / "Chart.yaml").write_text("apiVersion: v2\nname: shared\nversion: 0.1.0\ntype: library\n")
    (shared / "templates" / "_app.tpl").write_text('{{ define "x" }}{{ end }}\n')
    return folder


def members(archive: bytes) -> list[tarfile.TarInfo]:
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        return tar.getmembers()


def content(archive: bytes, name: str) -> str:
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        file = tar.extractfile(name)
        assert file
        return file.read().decode()


def test_a_copy_touched_later_has_the_same_digest(chart: Path, tmp_path: Path) -> None:
    first = pack(chart, IMAGES)
    other = tmp_path / "elsewhere" / "named-differently"
    shutil.copytree(chart, other)
    shutil.copytree(tmp_path / "shared", tmp_path / "elsewhere" / "shared")
    for path in other.rglob("*"):
        os.utime(path, (1, 1))
        path.chmod(0o700)
    second = pack(other, dict(reversed(IMAGES.items())))
    assert first == second
    assert first.digest == sha256(first.manifest)


def test_chart_file_first_then_by_name_with_libraries_and_images(chart: Path) -> None:
    packed = pack(chart, IMAGES)
    files = members(packed.archive)
    assert [member.name for member in files] == [
        "app/Chart.yaml",
        "app/charts/shared/Chart.yaml",
        "app/charts/shared/templates/_app.tpl",
        "app/images.yaml",
        "app/templates/object.yaml",
    ]
    assert {(m.mtime, m.uid, m.gid, m.mode, m.uname) for m in files} == {(0, 0, 0, 0o644, "")}
    assert content(packed.archive, "app/images.yaml") == "platform: host/platform@sha256:2\nros: host/ros@sha256:1\n"


def test_manifest_names_config_and_archive(chart: Path) -> None:
    packed = pack(chart, {})
    manifest = json.loads(packed.manifest)
    assert manifest["config"]["digest"] == sha256(packed.config)
    assert manifest["layers"][0] == {
        "digest": sha256(packed.archive),
        "mediaType": "application/vnd.cncf.helm.chart.content.v1.tar+gzip",
        "size": len(packed.archive),
    }
    assert json.loads(packed.config)["name"] == "app"
    assert gzip.decompress(packed.archive)[:14] == b"app/Chart.yaml"


def test_a_byte_changes_the_digest(chart: Path) -> None:
    first = pack(chart, IMAGES).digest
    assert pack(chart, IMAGES | {"ros": "host/ros@sha256:3"}).digest != first
    (chart / "templates" / "object.yaml").write_text("kind: Secret\n")
    assert pack(chart, IMAGES).digest != first


def test_a_chart_names_the_images_it_uses(chart: Path) -> None:
    text = (chart / "Chart.yaml").read_text()
    (chart / "Chart.yaml").write_text(text + "annotations: {robotkube.io/images: ros}\n")
    assert content(pack(chart, IMAGES).archive, "app/images.yaml") == "ros: host/ros@sha256:1\n"
    (chart / "Chart.yaml").write_text(text + "annotations: {robotkube.io/images: ros rose}\n")
    with pytest.raises(DocumentError, match=r"Chart\.yaml: annotations: .*no image rose; there are platform, ros"):
        pack(chart, IMAGES)


def test_the_link_to_a_named_library_is_replaced_by_the_library(chart: Path) -> None:
    digest = pack(chart, {}).digest
    (chart / "charts").mkdir()
    (chart / "charts" / "shared").symlink_to("../../shared")
    assert pack(chart, {}).digest == digest


def test_links_and_hidden_files_are_refused_together(chart: Path) -> None:
    (chart / "templates" / "link.yaml").symlink_to("object.yaml")
    (chart / "folder").symlink_to("templates")
    (chart / ".hidden").write_text("x")
    with pytest.raises(DocumentError) as caught:
        pack(chart, {})
    text = str(caught.value)
    assert str(chart) in text
    assert "templates/link.yaml: a link" in text
    assert "folder: a link" in text
    assert ".hidden: a hidden file; remove it or list it in .helmignore" in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("apiVersion: v2\nname: App\nversion: 0.1.0\n", "name: 'App' is no chart name"),
        ("apiVersion: v2\nname: app\nversion: one\n", "version: 'one' is no semantic version"),
        ("- a\n", "not a map of keys"),
        ("a: [\n", "no YAML"),
        (
            "name: app\nversion: 0.1.0\ndependencies: [{name: x, repository: 'https://charts.invalid'}]\n",
            "dependencies: x: repository 'https://charts.invalid' is not local",
        ),
        (
            "name: app\nversion: 0.1.0\ndependencies: [{name: y, repository: 'file://../shared'}]\n",
            "dependencies: y: the chart in .* is named 'shared'",
        ),
        (
            "name: app\nversion: 0.1.0\ndependencies: [{name: y, repository: 'file://../gone'}]\n",
            "gone/Chart.yaml: missing",
        ),
    ],
)
def test_a_bad_chart_file_is_refused_with_file_and_fix(chart: Path, text: str, message: str) -> None:
    (chart / "Chart.yaml").write_text(text)
    with pytest.raises(DocumentError, match=message):
        pack(chart, {})


def test_images_of_the_chart_itself_are_refused(chart: Path) -> None:
    (chart / "images.yaml").write_text("ros: x\n")
    with pytest.raises(DocumentError, match=r"images\.yaml: packing adds this file"):
        pack(chart, IMAGES)


def test_a_path_too_long_for_the_archive_is_named() -> None:
    files = {"Chart.yaml": b"", "templates/" + "x" * 100: b""}
    with pytest.raises(DocumentError, match="longer than 100 bytes"):
        pack_chart("app", {"name": "app", "version": "0.1.0"}, files)


def test_the_tag_of_a_version_with_build_metadata() -> None:
    packed = pack_chart("app", {"name": "app", "version": "0.1.0+build.1"}, {"Chart.yaml": b"x"})
    assert packed.tag == "0.1.0_build.1"


def test_the_digest_covers_the_catalogue_entry(chart: Path) -> None:
    spec = {"version": "0.1.0", "guarantees": [{"name": "latency", "atMost": 20, "unit": "ms"}]}
    packed = pack(chart, IMAGES, spec)
    assert json.loads(packed.manifest)["annotations"]["robotkube.io/entry"] == entry_digest(spec)
    assert packed == pack(chart, IMAGES, dict(reversed(spec.items())))
    assert packed.digest != pack(chart, IMAGES, {**spec, "guarantees": []}).digest


def test_a_build_has_a_tag_of_its_own() -> None:
    assert build_tag("0.1.0+a", "sha256:" + "12ab" * 16) == "0.1.0_a_12ab12ab12ab"
