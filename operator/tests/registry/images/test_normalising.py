"""The same contents in two exports that differ in all that builders leave to chance give the same archive."""

import hashlib
import io
import json
import tarfile
from pathlib import Path
from typing import Any

import pytest

from robotkube.registry.images.adapters import normalising

GOLDEN_LAYER = "sha256:2e79b9ad559123994f98da62a363f316ab24f7438ed8835fdd64432d01d4f8cb"
Entry = tuple[str, bytes | str | None, dict[str, Any]]
ENTRIES: list[Entry] = [
    ("etc", None, {"mode": 0o755}),
    ("etc/b", b"two", {"mode": 0o640, "uid": 3, "gid": 4}),
    ("etc/a", b"one", {"mode": 0o4755}),
    ("etc/z", "etc/b", {"hard": True}),
    ("etc/link", "a", {}),
    ("etc/.wh.gone", b"", {}),
]


def tar_of(entries: list[Entry], mtime: int = 0, prefix: str = "") -> bytes:
    raw = io.BytesIO()
    with tarfile.open(fileobj=raw, mode="w") as tar:
        for name, content, more in entries:
            info = tarfile.TarInfo(prefix + name)
            info.mtime = mtime
            info.uname = f"user{mtime}"
            info.mode, info.uid, info.gid = more.get("mode", 0o644), more.get("uid", 0), more.get("gid", 0)
            if content is None:
                info.type = tarfile.DIRTYPE
            elif isinstance(content, str):
                info.type = tarfile.LNKTYPE if more.get("hard") else tarfile.SYMTYPE
                info.linkname = content
            data = content if isinstance(content, bytes) else b""
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    return raw.getvalue()


def exported_of(folder: Path, layers: list[bytes], created: str) -> Path:
    folder.mkdir()

    def put(data: bytes) -> dict[str, Any]:
        digest = hashlib.sha256(data).hexdigest()
        (folder / digest).write_bytes(data)
        return {"digest": f"sha256:{digest}", "size": len(data)}

    settings = {"User": "10001:10001", "Env": ["A=1"], "Labels": {"io.buildah.version": created, "title": "x"}}
    config = {"architecture": "amd64", "os": "linux", "created": created, "config": settings, "history": [created]}
    manifest = {"config": put(json.dumps(config).encode()), "layers": [put(layer) for layer in layers]}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def normal_entries(tmp_path: Path, raw: bytes, placeholders: frozenset[str] = frozenset()) -> list[tarfile.TarInfo]:
    (tmp_path / "raw").write_bytes(raw)
    if normalising.normalise_layer(tmp_path / "raw", tmp_path / "normal", placeholders) is None:
        return []
    with tarfile.open(tmp_path / "normal") as tar:
        return tar.getmembers()


def test_order_times_and_names_of_owners_do_not_count(tmp_path: Path) -> None:
    one = exported_of(tmp_path / "one", [tar_of(ENTRIES, 1)], "2026-05-01T00:00:00Z")
    # files before their links, which is how every tar comes; everything else the other way round
    other_order = [ENTRIES[i] for i in (5, 4, 2, 1, 3, 0)]
    two = exported_of(tmp_path / "two", [tar_of(other_order, 99, "./")], "2026-06-01T00:00:00Z")
    images = [normalising.normalise_image(raw, raw.with_suffix(".tar"), "host/name") for raw in (one, two)]
    assert (images[0].digest, images[0].layers) == (images[1].digest, images[1].layers)
    assert one.with_suffix(".tar").read_bytes() == two.with_suffix(".tar").read_bytes()


def test_modes_owners_links_and_whiteouts_are_kept(tmp_path: Path) -> None:
    entries = {entry.name: entry for entry in normal_entries(tmp_path, tar_of(ENTRIES, 7))}
    assert list(entries) == sorted(entries)
    assert {entry.mtime for entry in entries.values()} == {normalising.EPOCH_SECONDS}
    assert entries["etc/a"].mode == 0o4755
    assert (entries["etc/b"].uid, entries["etc/b"].gid, entries["etc/b"].mode) == (3, 4, 0o640)
    assert (entries["etc/z"].islnk(), entries["etc/z"].linkname, entries["etc/z"].mode) == (True, "etc/b", 0o640)
    assert entries["etc/link"].linkname == "a"
    assert "etc/.wh.gone" in entries


def test_the_first_name_of_a_file_carries_its_content(tmp_path: Path) -> None:
    entries: list[Entry] = [("z", b"text", {}), ("a", "z", {"hard": True})]
    by_name = {entry.name: entry for entry in normal_entries(tmp_path, tar_of(entries))}
    assert by_name["a"].isreg()
    assert by_name["a"].size == 4
    assert by_name["z"].linkname == "a"


def test_normal_form_is_a_fixed_point(tmp_path: Path) -> None:
    (tmp_path / "raw").write_bytes(tar_of(ENTRIES))
    first = normalising.normalise_layer(tmp_path / "raw", tmp_path / "first")
    assert normalising.normalise_layer(tmp_path / "first", tmp_path / "second") == first


def test_placeholders_go_and_contents_stay(tmp_path: Path) -> None:
    entries: list[Entry] = [("mnt/lent", None, {}), ("etc/pip.conf", b"", {}), ("etc/hosts", b"kept", {})]
    points = frozenset({"mnt/lent", "etc/pip.conf", "etc/hosts"})
    assert [entry.name for entry in normal_entries(tmp_path, tar_of(entries), points)] == ["etc/hosts"]


def test_a_layer_of_placeholders_only_is_no_layer(tmp_path: Path) -> None:
    raw = exported_of(tmp_path / "raw", [tar_of([("x", b"1", {})]), tar_of([("mnt/lent", None, {})])], "now")
    image = normalising.normalise_image(raw, tmp_path / "image.tar", "host/name", frozenset({"mnt/lent"}))
    assert len(image.layers) == 1


def test_configuration_keeps_what_counts_at_run_time(tmp_path: Path) -> None:
    raw = exported_of(tmp_path / "raw", [tar_of(ENTRIES)], "2026-05-01T00:00:00Z")
    image = normalising.normalise_image(raw, tmp_path / "image.tar", "host/name")
    with tarfile.open(tmp_path / "image.tar") as tar:
        files = {member.name: tar.extractfile(member).read() for member in tar}  # type: ignore[union-attr]
    entry = json.loads(files["index.json"])["manifests"][0]
    assert entry["annotations"]["io.containerd.image.name"] == f"host/name@{image.digest}"
    manifest = json.loads(files["blobs/sha256/" + image.digest.removeprefix("sha256:")])
    config = json.loads(files["blobs/" + manifest["config"]["digest"].replace(":", "/")])
    assert config["config"] == {"User": "10001:10001", "Env": ["A=1"], "Labels": {"title": "x"}}
    assert config["created"] == normalising.EPOCH_TEXT
    assert config["rootfs"]["diff_ids"] == [layer["digest"] for layer in manifest["layers"]]


def test_the_format_is_what_its_number_says(tmp_path: Path) -> None:
    """If this fails the bytes changed: raise normalising.FORMAT, else cached archives and new ones are mixed."""
    (tmp_path / "raw").write_bytes(tar_of(ENTRIES))
    blob = normalising.normalise_layer(tmp_path / "raw", tmp_path / "normal")
    assert blob is not None
    assert (normalising.FORMAT, blob.digest) == ("1", GOLDEN_LAYER)


def test_a_link_to_a_file_of_another_layer_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"link to gone, which is not in the layer"):
        normal_entries(tmp_path, tar_of([("a", "gone", {"hard": True})]))


def test_a_layer_known_from_an_earlier_archive_is_taken_from_there(tmp_path: Path) -> None:
    raw = exported_of(tmp_path / "raw", [tar_of(ENTRIES, 5)], "now")
    first = normalising.normalise_image(raw, tmp_path / "first.tar", "host/name")
    (origin,) = first.origins
    known = {origin: normalising.KnownLayer(tmp_path / "first.tar", first.layers[0])}
    (raw / origin.removeprefix("sha256:")).unlink()
    second = normalising.normalise_image(raw, tmp_path / "second.tar", "host/name", known=known)
    assert second == first
    assert (tmp_path / "second.tar").read_bytes() == (tmp_path / "first.tar").read_bytes()
