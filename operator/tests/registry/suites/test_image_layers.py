"""Layers are read as streams, compressed or not, within bounds; what was read is kept by digest."""

from __future__ import annotations

import gzip
import tarfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import zstandard

from robotkube.errors import InputError
from robotkube.registry.suites.adapters import image_layers, kept_layers
from robotkube.registry.suites.adapters.image_layers import KeptContents, read_layer
from robotkube.registry.suites.adapters.kept_layers import KeptLayers
from tests.stages.registry.made_layers import COMPRESSIONS, ELF, FILES, digest_of, hex_of, made_layer


def pieces(data: bytes, size: int = 97) -> Iterator[bytes]:
    return (data[start : start + size] for start in range(0, len(data), size))


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_layer_reads_the_same_however_it_is_compressed(compression: str) -> None:
    plain = made_layer(FILES)
    assert read_layer(pieces(COMPRESSIONS[compression](plain))) == read_layer(iter([plain]))
    assert read_layer(iter([made_layer(FILES, "./")])).entries[:2] == read_layer(iter([plain])).entries[:2]


def test_every_piece_is_taken_so_that_the_digest_is_checked() -> None:
    given = []
    data = made_layer(FILES) + bytes(5_000_000)

    def counted() -> Iterator[bytes]:
        for piece in pieces(data, 1 << 16):
            given.append(len(piece))
            yield piece

    read_layer(counted())
    assert sum(given) == len(data)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"no tar" * 200,
        gzip.compress(made_layer(FILES))[:-200],
        gzip.compress(b"no tar" * 200),
        zstandard.compress(made_layer(FILES))[:-50],
        b"\x1f\x8bno gzip" + bytes(600),
        b"\x28\xb5\x2f\xfdno zstd" + bytes(600),
        made_layer(FILES)[:2000],
    ],
    ids=["empty", "text", "torn gzip", "gzip of text", "torn zstd", "no gzip", "no zstd", "torn tar"],
)
def test_what_is_no_layer_is_refused(data: bytes) -> None:
    with pytest.raises(InputError, match="not readable as a layer"):
        read_layer(pieces(data))


def entry(name: str, size: int = 0, kind: bytes = tarfile.REGTYPE, headers: dict[str, str] | None = None) -> bytes:
    info = tarfile.TarInfo(name)
    info.size = size
    info.type = kind
    info.pax_headers = headers or {}
    return info.tobuf(format=tarfile.PAX_FORMAT)


def test_a_small_blob_that_unpacks_to_much_is_not_read_further(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(image_layers, "UNPACKED_BYTES_MAX", 1 << 20)
    bomb = entry("zeros", 1 << 24) + bytes(1 << 24)
    for compress in (gzip.compress, zstandard.compress):
        with pytest.raises(InputError, match="unpacks to more than 0 GiB"):
            read_layer(pieces(compress(bomb), 1 << 16))


def test_entries_headers_and_lists_have_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    long_header = entry("x", headers={"comment": "a" * (2 << 20)})
    with pytest.raises(InputError, match="header has more than 1048576 bytes"):
        read_layer(pieces(long_header, 1 << 16))
    monkeypatch.setattr(image_layers, "ENTRIES_MAX", 5)
    with pytest.raises(InputError, match="more than 5 entries"):
        read_layer(pieces(made_layer(FILES)))
    monkeypatch.setattr(image_layers, "TEXT_BYTES_MAX", 30)
    with pytest.raises(InputError, match="/var/lib/dpkg/status: a list of packages of more than 30 bytes"):
        read_layer(pieces(made_layer(FILES)))


@pytest.mark.parametrize("name", ["../etc/passwd", "usr/../../x", "a/" * 3000])
def test_a_path_out_of_the_image_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="a path that leads out of the image"):
        read_layer(iter([made_layer({name: b""})]))


def test_a_sparse_file_is_refused() -> None:
    sparse = entry("big", headers={"GNU.sparse.map": "0,0", "GNU.sparse.size": str(1 << 60), "GNU.sparse.name": "big"})
    with pytest.raises(InputError, match="/big: a sparse file"):
        read_layer(iter([sparse + bytes(1024)]))


HIDDEN = entry("usr/bin/hidden", len(ELF)) + ELF.ljust(512, b"\0")
FIRST = entry("etc/hello")
END = bytes(1024)


def changed(header: bytes, **fields: bytes) -> bytes:
    """A header with other bytes in some of its fields, and a checksum that fits."""
    block = bytearray(header)
    for name, value in fields.items():
        start = PLACES[name]
        block[start : start + len(value)] = value
    block[148:156] = b" " * 8
    block[148:156] = b"%06o\0 " % sum(block)
    return bytes(block)


PLACES = {"name": 0, "uid": 108, "size": 124, "kind": 156, "magic": 257, "major": 329, "prefix": 345, "trailer": 508}
OLDEST = {"kind": b"\0"}


def pax(**records: str) -> bytes:
    """An extended header alone, without the entry that it speaks of."""
    return entry("x", headers=records)[:-512]


def long_name(name: str, kind: bytes = b"L") -> bytes:
    return changed(entry("././@LongLink", len(name) + 1), kind=kind) + name.encode().ljust(512, b"\0")


TWO_WAYS = {
    "a number that Python takes for the end": (
        changed(entry("etc/marker"), major=b"\x81" + bytes(7)) + HIDDEN,
        "its devmajor",
    ),
    "a size of 0 to Python and 512 to Go": (
        changed(entry("etc/marker"), size=bytes(4) + b"0001000\0") + HIDDEN,
        "its size",
    ),
    "digits with an underscore": (changed(entry("etc/marker"), uid=b"000_000\0"), "its uid"),
    "a size below zero": (changed(entry("etc/marker"), size=b"\xff" * 12), "its size"),
    "a checksum that does not hold": (FIRST[:148] + b"000000\0 " + FIRST[156:] + HIDDEN, "bad checksum"),
    "something behind the end": (END + HIDDEN, "something follows the end"),
    "one empty block before more": (bytes(512) + HIDDEN, "something follows the end"),
    "a global header": (changed(pax(size="0"), kind=b"g") + HIDDEN, "its kind"),
    "a kind that only some know": (changed(entry("etc/marker", 512), kind=b"V") + HIDDEN, "its kind"),
    "a format that nobody has": (changed(entry("etc/marker"), magic=b"ustar\x0001"), "its format"),
    "a folder of the oldest kind": (changed(entry("x/", 512), **OLDEST) + HIDDEN, "the oldest kind"),
    "a folder by its extended name": (pax(path="x/") + changed(entry("x", 512), **OLDEST) + HIDDEN, "the oldest kind"),
    "a folder by its long name": (long_name("x/") + changed(entry("x", 512), **OLDEST) + HIDDEN, "the oldest kind"),
    "two extended headers": (pax(path="a") + pax(path="b") + HIDDEN, "several headers"),
    "two long names": (long_name("a") + long_name("b") + HIDDEN, "several headers"),
    "a long name in an extended header": (pax(path="a") + long_name("b") + HIDDEN, "several headers"),
    "an extended header behind a long name": (long_name("b") + pax(path="a") + HIDDEN, "several headers"),
    "a prefix in GNU's format": (changed(HIDDEN, magic=b"ustar  \0", prefix=b"opt"), "it has a prefix"),
    "a prefix in star's": (changed(HIDDEN, prefix=b"opt", trailer=b"tar\0"), "it has a prefix"),
    "an extended size that is none": (pax(size="0x200") + HIDDEN, "a size of '0x200'"),
}


@pytest.mark.parametrize("case", TWO_WAYS)
def test_what_others_read_in_another_way_is_refused(case: str) -> None:
    """A file was hidden so from bill and suite and ran on a cluster (the first case)."""
    data, words = TWO_WAYS[case]
    with pytest.raises(InputError, match=words):
        read_layer(pieces(FIRST + data + END))


def test_a_header_that_is_cut_off_is_no_end() -> None:
    with pytest.raises(InputError, match="the header of 'more': it is cut off"):
        read_layer(pieces(FIRST + HIDDEN + entry("more")[:100]))


def test_what_usual_tools_write_is_read() -> None:
    """Long names and links of GNU, extended headers, times below zero, big numbers, no end at all."""
    name = "a/" * 90 + "name"
    data = FIRST + long_name("far/away", b"K") + long_name(name) + HIDDEN
    data += entry("é" * 80, headers={"mtime": "-1.5", "SCHILY.xattr.security.capability": "x"})
    data += changed(entry("old"), magic=bytes(8)) + changed(entry("older"), **OLDEST, magic=bytes(8))
    data += changed(entry("u"), uid=b"\x80" + bytes(6) + b"\x07", magic=b"ustar  \0")
    data += changed(entry("deep"), prefix=b"usr/share")
    names = ["etc/hello", name, "é" * 80, "old", "older", "u", "usr/share/deep"]
    for end in (END, b"", bytes(512), bytes(10240)):
        layer = read_layer(pieces(data + end))
        assert [one.path for one in layer.entries] == names
        assert [one.path for one in layer.entries if one.is_elf] == [name]


def test_files_that_are_asked_for_are_kept_by_digest(tmp_path: Path) -> None:
    layer = read_layer(iter([made_layer(FILES)]), KeptContents(lambda path, head: path.endswith("script"), tmp_path))
    script = next(one for one in layer.entries if one.path == "usr/bin/script")
    assert script.sha256 == hex_of(b"#!/bin/sh\n")
    assert [file.name for file in tmp_path.iterdir()] == [script.sha256]
    assert (tmp_path / script.sha256).read_bytes() == b"#!/bin/sh\n"


class Blobs:
    """Gives one layer and counts how often."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.digest = digest_of(data)
        self.asked = 0

    def __call__(self) -> Iterator[bytes]:
        self.asked += 1
        return pieces(self.data, 1 << 16)


def test_a_layer_is_read_once_for_all_processes(tmp_path: Path) -> None:
    blobs = Blobs(made_layer({**FILES, ".wh.gone": b"", "var/.wh..wh..opq": b""}))
    first = KeptLayers(tmp_path / "kept").contents(blobs.digest, blobs)
    assert KeptLayers(tmp_path / "kept").contents(blobs.digest, blobs) == first == read_layer(blobs())
    assert blobs.asked == 2  # once by this line above


def test_a_kept_file_that_is_broken_or_of_others_is_not_used(tmp_path: Path) -> None:
    blobs = Blobs(made_layer(FILES))
    kept = KeptLayers(tmp_path / "kept")
    kept.contents(blobs.digest, blobs)
    (file,) = (tmp_path / "kept").iterdir()
    file.write_bytes(file.read_bytes()[:-3])
    kept.contents(blobs.digest, blobs)
    assert blobs.asked == 2
    (tmp_path / "kept").chmod(0o777)
    kept.contents(blobs.digest, blobs)
    assert blobs.asked == 3


def test_a_layer_with_wrong_bytes_is_not_kept(tmp_path: Path) -> None:
    def wrong() -> Iterator[bytes]:
        yield made_layer({"usr/bin/x": ELF})
        raise InputError("has other bytes than it should")

    for _ in range(2):
        with pytest.raises(InputError, match="other bytes"):
            KeptLayers(tmp_path / "kept").contents("sha256:0", wrong)


def test_the_oldest_make_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_layers, "KEPT_MAX", 2)
    kept = KeptLayers(tmp_path / "kept")
    for number in range(4):
        blobs = Blobs(made_layer({f"file-{number}": b""}))
        kept.contents(blobs.digest, blobs)
    assert len(list((tmp_path / "kept").iterdir())) == 2
