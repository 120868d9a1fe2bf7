"""Headers of a tar archive, read strictly: what two programs could read differently is refused.

Python's `tarfile` takes a header that it dislikes as the end of the archive, reads a size with leading NULs as 0 and
applies global headers to all that follows; Go's `archive/tar`, by which container engines unpack, does none of it. Each
of the three hides files from whoever looks by the one what the other will unpack.
"""

from __future__ import annotations

import re
import tarfile
from typing import Self

from robotkube.errors import InputError

BLOCK_BYTES = tarfile.BLOCKSIZE
OCTAL = re.compile(rb" *[0-7]*[ \0]*")
KINDS = b"01234567\0"  # what stands for itself
LONG, PAX = b"LK", b"x"
EXTENDING = LONG + PAX  # what belongs to the next one
POSIX = b"ustar\x0000"
GNU = b"ustar  \0"
OLD = bytes(8)
STAR = b"tar\0"  # its archives have times in the place of the prefix
NUMBERS = {
    "mode": slice(100, 108),
    "uid": slice(108, 116),
    "gid": slice(116, 124),
    "size": slice(124, 136),
    "mtime": slice(136, 148),
    "checksum": slice(148, 156),
    "devmajor": slice(329, 337),
    "devminor": slice(337, 345),
}
NAME, PREFIX = slice(0, 100), slice(345, 500)


class StrictHeader(tarfile.TarInfo):
    """A header as `tarfile` makes it, once nothing in it can be read in two ways. One archive is read by one class of
    its own, which `strict_header` makes: what comes before a header matters."""

    before: list[bytes]

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> Self:
        """The header in a block. InputError names what is wrong with it; the errors of `tarfile` mean its end."""
        block = bytes(buf)
        if block and block.count(0) < len(block):
            _check(block, cls.before)
        try:
            header = super().frombuf(buf, encoding, errors)
        except tarfile.HeaderError as error:
            if any(block):
                raise _refusal(block, str(error)) from error
            raise
        kind = block[156:157]
        cls.before = [*cls.before, kind] if kind in EXTENDING else []
        return header


def strict_header() -> type[StrictHeader]:
    """The class of the headers of one archive."""
    return type("OneArchive", (StrictHeader,), {"before": []})


def check_records(header: tarfile.TarInfo) -> None:
    """Refuse extended records that change what an entry holds in ways that not everybody knows."""
    for key, value in header.pax_headers.items():
        if key.startswith("GNU.sparse"):
            raise InputError(f"/{header.name}: a sparse file, whose bytes are not in the layer; write it out")
        if key == "size" and not (value.isascii() and value.isdecimal()):
            raise InputError(
                f"/{header.name[:80]}: a size of {value[:20]!r} in its extended header; write the layer anew"
            )


def _check(block: bytes, before: list[bytes]) -> None:
    if len(block) < BLOCK_BYTES:
        raise _refusal(block, "it is cut off")
    magic, kind = block[257:265], block[156:157]
    if magic not in (POSIX, GNU, OLD):
        raise _refusal(block, f"its format {magic!r} is none of ustar and GNU")
    if kind not in KINDS + EXTENDING:
        raise _refusal(block, f"its kind {kind!r} is not known to everybody")
    for name, place in NUMBERS.items():
        if not (_is_octal(block[place]) or _is_binary(block[place], name)):
            raise _refusal(block, f"its {name} {block[place]!r} is no number that everybody reads the same")
    if any(block[PREFIX]) and (magic != POSIX or block.endswith(STAR)):
        raise _refusal(block, "it has a prefix, which only the format ustar has")
    if kind == b"\0" and (before or _text(block[NAME]).endswith(b"/")):
        raise _refusal(block, "it is of the oldest kind, and whether it is a folder depends on who reads it")
    if (kind == PAX and before) or (kind in LONG and {PAX, kind} & {*before}):
        raise _refusal(block, "several headers speak of the next one")


def _is_octal(field: bytes) -> bool:
    return OCTAL.fullmatch(field) is not None


def _is_binary(field: bytes, name: str) -> bool:
    """A number to the base of 256, which GNU writes where octal digits do not do; times may be below zero."""
    return field[0] == 0x80 or (field[0] == 0xFF and name == "mtime")


def _text(field: bytes) -> bytes:
    return field.split(b"\0", 1)[0]


def _refusal(block: bytes, why: str) -> InputError:
    name = _text(block[NAME]).decode("utf-8", "backslashreplace")[:80]
    return InputError(f"not readable as a layer: the header of {name!r}: {why}; write the layer anew with a usual tool")
