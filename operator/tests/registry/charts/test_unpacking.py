"""Charts out of a registry: what we pack comes back, everything else is refused before it can do harm."""

from __future__ import annotations

import gzip
import io
import json
import random
import tarfile
import zlib
from collections.abc import Mapping
from typing import Any

import pytest

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.charts.core.packing import CHART_CONFIG_TYPE, CHART_LAYER_TYPE, PackedChart, pack_chart
from robotkube.registry.charts.core.unpacking import (
    ARCHIVE_BYTES_MAX,
    FILES_MAX,
    UNPACKED_BYTES_MAX,
    read_chart_manifest,
    unpack_chart,
)

METADATA = {"apiVersion": "v2", "name": "app", "version": "0.1.0"}
CHART_YAML = json.dumps(METADATA).encode()
FILES = {"Chart.yaml": CHART_YAML, "templates/object.yaml": b"kind: ConfigMap\n", "charts/shared/Chart.yaml": b"x"}


def chart(files: Mapping[str, bytes] = FILES, metadata: Mapping[str, Any] = METADATA) -> PackedChart:
    return pack_chart("app", metadata, files)


def refusal(archive: bytes, packed: PackedChart | None = None) -> str:
    packed = packed or chart()
    with pytest.raises(DocumentError) as caught:
        unpack_chart("verified/app", packed.manifest, packed.config, archive)
    assert str(caught.value).startswith("verified/app: ")
    return str(caught.value)


def member(
    name: str, data: bytes = b"", kind: bytes = tarfile.REGTYPE, link: str = ""
) -> tuple[tarfile.TarInfo, bytes]:
    info = tarfile.TarInfo(name)
    info.size = len(data)
    info.type = kind
    info.linkname = link
    return info, data


def archive(*members: tuple[tarfile.TarInfo, bytes], form: int = tarfile.USTAR_FORMAT) -> bytes:
    """An archive with Chart.yaml and these members."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=form) as tar:
        for info, data in (member("app/Chart.yaml", CHART_YAML), *members):
            tar.addfile(info, io.BytesIO(data))
    return gzip.compress(buffer.getvalue(), mtime=0)


def test_what_was_packed_comes_back() -> None:
    packed = chart()
    unpacked = unpack_chart("verified/app", packed.manifest, packed.config, packed.archive)
    assert (unpacked.files, unpacked.metadata, unpacked.digest) == (FILES, METADATA, packed.digest)
    assert chart(unpacked.files, unpacked.metadata).digest == packed.digest


def test_the_manifest_names_configuration_and_archive() -> None:
    packed = chart()
    config, layer = read_chart_manifest(packed.manifest, "verified/app")
    assert (config.digest, layer.digest) == (sha256(packed.config), sha256(packed.archive))
    assert (config.size, layer.size) == (len(packed.config), len(packed.archive))


@pytest.mark.parametrize(
    ("name", "kind", "link"),
    [
        ("app/link", tarfile.SYMTYPE, "/etc/passwd"),
        ("app/link", tarfile.SYMTYPE, "Chart.yaml"),
        ("app/link", tarfile.LNKTYPE, "app/Chart.yaml"),
        ("app/device", tarfile.CHRTYPE, ""),
        ("app/pipe", tarfile.FIFOTYPE, ""),
        ("app/folder", tarfile.DIRTYPE, ""),
        ("app/sparse", tarfile.GNUTYPE_SPARSE, ""),
        ("app/odd", b"Z", ""),
    ],
)
def test_only_plain_files_are_taken(name: str, kind: bytes, link: str) -> None:
    assert "is no plain file" in refusal(archive(member(name, kind=kind, link=link)))


@pytest.mark.parametrize(
    "name",
    [
        *("/etc/cron.d/own", "../own", "app/../own", "app/../../own", "app/./own", "app//own", "other/own", "app"),
        *("app/a/../../own", "app/a\\own", "app/.../own", "app/templates/", "app/new\nline", "app/ä", "app/a b"),
        "app/" + "x" * 101,
    ],
)
def test_every_file_stays_plainly_below_its_folder(name: str) -> None:
    form = tarfile.GNU_FORMAT if len(name) > 100 else tarfile.USTAR_FORMAT
    text = refusal(archive(member(name, b"x"), form=form))
    assert "plainly below app/" in text or "is no plain file" in text


@pytest.mark.parametrize(
    "name", [".argocd-source.yaml", ".argocd-source-cloud-0.yaml", ".helmignore", "templates/.pod.yaml", ".git/config"]
)
def test_hidden_files_are_refused(name: str) -> None:
    """Argo CD would lay what `.argocd-source.yaml` says over the values that the gate checked."""
    text = refusal(archive(member(f"app/{name}", b"helm: {parameters: [{name: image.reference, value: other}]}")))
    assert f"'app/{name}': a hidden file; Argo CD takes settings from some, so leave it out of the chart" in text


def test_extended_headers_are_refused() -> None:
    info, data = member("app/" + "x" * 90 + "/" + "y" * 90, b"x")
    assert "is no plain file" in refusal(archive((info, data), form=tarfile.GNU_FORMAT))
    info.pax_headers = {"path": "app/other"}
    assert "is no plain file" in refusal(archive((info, data), form=tarfile.PAX_FORMAT))


def test_a_name_stands_once_and_is_a_file_or_a_folder() -> None:
    assert "stands twice" in refusal(archive(member("app/a", b"1"), member("app/a", b"2")))
    clash = archive(member("app/a/b", b"1"), member("app/a", b"2"))
    assert "a/b: a file and a folder have the same name" in refusal(clash)


def test_files_are_counted() -> None:
    many = archive(*(member(f"app/files/{number}", b"") for number in range(FILES_MAX)))
    assert f"more than {FILES_MAX} files" in refusal(many)


def test_a_bomb_is_refused_before_it_is_unpacked() -> None:
    packing = zlib.compressobj(9, zlib.DEFLATED, 16 + zlib.MAX_WBITS)
    zeros = b"\0" * 1024 * 1024
    first, again = (packing.compress(zeros) + packing.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    bomb = first + 511 * again + packing.flush()
    assert len(bomb) < ARCHIVE_BYTES_MAX
    assert f"grows beyond {UNPACKED_BYTES_MAX} bytes" in refusal(bomb)


def test_what_is_cut_off_or_longer_than_it_says_is_refused() -> None:
    good = chart().archive
    assert "cut off or has something behind its end" in refusal(good[:-4])
    assert "cut off or has something behind its end" in refusal(good + b"more")
    assert "cut off or has something behind its end" in refusal(good + good)
    assert "is not readable as gzip" in refusal(b"no archive")
    tar = gzip.decompress(good)
    assert "cut off" in refusal(gzip.compress(tar[:700]))
    assert "is not readable as tar" in refusal(gzip.compress(b"x" * 1024))
    assert "something behind its end" in refusal(gzip.compress(tar + b"hidden" * 100))
    negative = bytearray(tar)
    negative[124:136] = b"\xff" * 12
    assert "is not readable as tar" in refusal(gzip.compress(bytes(negative)))


def test_chart_yaml_configuration_and_annotations_agree() -> None:
    other = chart({**FILES, "Chart.yaml": b'{"apiVersion": "v2", "name": "app", "version": "9.9.9"}'})
    assert "Chart.yaml, configuration and annotations differ" in refusal(other.archive, other)
    manifest = json.loads(chart().manifest) | {"annotations": {}}
    packed = PackedChart("app", "0.1.0", chart().archive, chart().config, canonical_json(manifest))
    assert "annotations differ" in refusal(packed.archive, packed)
    none = archive_without_chart_yaml()
    assert "Chart.yaml is missing" in refusal(none)


def archive_without_chart_yaml() -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        info, data = member("app/values.yaml", b"{}")
        tar.addfile(info, io.BytesIO(data))
    return gzip.compress(buffer.getvalue())


@pytest.mark.parametrize(
    "config", [b"", b"[]", b"\xff", b"[" * 100_000, b"{}", b'{"name": "../app", "version": "0.1.0"}', b'{"name": []}']
)
def test_a_configuration_of_another_form_is_refused(config: bytes) -> None:
    with pytest.raises(DocumentError, match="verified/app: "):
        unpack_chart("verified/app", chart().manifest, config, chart().archive)


def described(**change: Any) -> bytes:
    document = json.loads(chart().manifest)
    document["layers"][0] |= change
    return canonical_json(document)


@pytest.mark.parametrize(
    ("manifest", "expected"),
    [
        (b"{", "not readable as JSON"),
        (b"[]", "must be a JSON object"),
        (b"{}", "exactly one layer"),
        (canonical_json({"layers": [1], "config": 1}), "not named by media type and sha256 digest"),
        (described(digest="md5:1"), "not named by media type and sha256 digest"),
        (described(size=ARCHIVE_BYTES_MAX + 1), f"at most {ARCHIVE_BYTES_MAX} are taken"),
        (described(size=-1), "has -1 bytes"),
        (described(size=True), "has True bytes"),
        (described(mediaType="application/x-tar"), f"no Helm chart: {CHART_CONFIG_TYPE}, application/x-tar"),
        (canonical_json(json.loads(chart().manifest) | {"layers": []}), "exactly one layer"),
    ],
)
def test_a_manifest_that_is_no_chart_is_refused(manifest: bytes, expected: str) -> None:
    with pytest.raises(DocumentError, match="verified/app: ") as caught:
        read_chart_manifest(manifest, "verified/app")
    assert expected in str(caught.value)
    assert CHART_LAYER_TYPE in chart().manifest.decode()


@pytest.mark.parametrize("count", [200, pytest.param(1000, marks=pytest.mark.thorough)])
def test_archives_changed_by_chance_are_refused_or_hold_plain_files(count: int) -> None:
    chance = random.Random(count)  # noqa: S311 - the same cases every time
    packed = chart()
    tar = gzip.decompress(packed.archive)
    refused = 0
    for _ in range(count):
        data = bytearray(tar)
        for _ in range(chance.randrange(1, 20)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        cut = gzip.compress(bytes(data[: chance.choice([len(data), chance.randrange(len(data))])]), 1)
        try:
            unpacked = unpack_chart("verified/app", packed.manifest, packed.config, cut)
        except DocumentError:
            refused += 1
        else:
            assert set(unpacked.files) == set(FILES)
    assert refused > count // 2
