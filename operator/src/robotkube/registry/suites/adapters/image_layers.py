"""Reads a layer of a container image as a stream: plain tar, gzip or zstd, told apart by its first bytes.

Nothing is unpacked to disk but what a caller asks to have kept. Every quantity has a bound: what a small blob unpacks
to, how many entries it has, how long their headers are.
"""

from __future__ import annotations

import gzip
import io
import tarfile
import tempfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

import zstandard

from robotkube.errors import InputError
from robotkube.registry.suites.adapters.tar_headers import check_records, strict_header
from robotkube.registry.suites.core import image_contents as contents
from robotkube.registry.suites.core.image_contents import Entry, LayerContents

UNPACKED_BYTES_MAX = 8 << 30  # of one layer
ENTRIES_MAX = 300_000  # of one layer
HEADER_BYTES_MAX = 1 << 20  # of one entry: long names, extended attributes
TEXT_BYTES_MAX = 16 << 20  # of a list of packages
WINDOW_BYTES_MAX = 128 << 20  # of zstd: more is only written by --ultra --long
BLOCK_BYTES = 1 << 20
PATH_CHARACTERS_MAX = 4096
ELF = b"\x7fELF"
GZIP = b"\x1f\x8b"
ZSTD = (b"\x28\xb5\x2f\xfd", b"\x2a\x4d\x18")  # the second, after one byte, is a skippable frame


@dataclass(frozen=True)
class KeptContents:
    """Which regular files are kept, by path and first four bytes, and the folder that gets them, named by their
    SHA-256."""

    wanted: Callable[[str, bytes], bool]
    folder: Path


def read_layer(blob: Iterator[bytes], kept: KeptContents | None = None) -> LayerContents:
    """The contents of the layer in `blob`, which is read to its end. InputError: it is no layer, or beyond a bound."""
    source: io.BufferedReader[Any] = io.BufferedReader(_Chunks(blob), BLOCK_BYTES)
    try:
        layer = _read(_Forward(unpacked(source)), kept)
        while source.read(BLOCK_BYTES):
            pass  # whoever gives the blob checks its digest at its end
    except (tarfile.TarError, zlib.error, zstandard.ZstdError, gzip.BadGzipFile, EOFError, UnicodeError) as error:
        raise InputError(f"not readable as a layer (tar, gzip or zstd): {error}") from error
    return layer


def unpacked(source: io.BufferedReader[Any]) -> IO[bytes]:
    """The plain bytes of a layer that may be compressed."""
    head = source.peek(4)[:4]
    if head.startswith(GZIP):
        return gzip.GzipFile(fileobj=source, mode="rb")  # type: ignore[return-value]
    if head == ZSTD[0] or head[1:] == ZSTD[1]:
        decompressor = zstandard.ZstdDecompressor(max_window_size=WINDOW_BYTES_MAX)
        return decompressor.stream_reader(source, read_size=BLOCK_BYTES, read_across_frames=True, closefd=False)
    return source


class _Chunks(io.RawIOBase):
    """A file of the pieces of a blob."""

    def __init__(self, blob: Iterator[bytes]) -> None:
        self._blob = blob
        self._rest = memoryview(b"")

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        while not self._rest:
            piece = next(self._blob, None)
            if piece is None:
                return 0
            self._rest = memoryview(piece)
        count = min(len(buffer), len(self._rest))
        buffer[:count] = self._rest[:count]
        self._rest = self._rest[count:]
        return count


class _Forward:
    """The unpacked layer, which only goes forward; `tarfile` reads each header at once, so a long read is one."""

    def __init__(self, source: IO[bytes]) -> None:
        self._source = source
        self._position = 0

    def tell(self) -> int:
        return self._position

    def seek(self, position: int) -> int:
        while self._position < position and self.read(min(position - self._position, BLOCK_BYTES)):
            pass
        return self._position

    def read(self, size: int) -> bytes:
        if not 0 <= size <= HEADER_BYTES_MAX:
            raise InputError(f"an entry's header has more than {HEADER_BYTES_MAX} bytes; it is not read")
        if self._position + size > UNPACKED_BYTES_MAX:
            raise InputError(f"a layer unpacks to more than {UNPACKED_BYTES_MAX >> 30} GiB; it is not read further")
        data = b""
        while len(data) < size and (more := self._source.read(size - len(data))):
            data += more
        self._position += len(data)
        return data


def _read(file: _Forward, kept: KeptContents | None) -> LayerContents:
    entries: list[Entry] = []
    hidden: list[str] = []
    emptied: list[str] = []
    with tarfile.open(fileobj=file, mode="r:", tarinfo=strict_header()) as tar:  # type: ignore[call-overload]
        while (member := tar.next()) is not None:
            tar.members.clear()  # tarfile would keep them all
            check_records(member)
            path = _path(member.name)
            folder, _, name = path.rpartition("/")
            if name == contents.OPAQUE:
                emptied.append(folder)
            elif name.startswith(contents.WHITEOUT):
                hidden.append(f"{folder}/{name.removeprefix(contents.WHITEOUT)}".lstrip("/"))
            elif path:
                entries.append(_entry(tar, member, path, kept))
            if len(entries) + len(hidden) + len(emptied) > ENTRIES_MAX:
                raise InputError(f"a layer has more than {ENTRIES_MAX} entries; it is not read further")
    while rest := file.read(BLOCK_BYTES):
        if rest.count(0) < len(rest):
            raise InputError("not readable as a layer: something follows the end of the archive; write the layer anew")
    return LayerContents(tuple(entries), tuple(hidden), tuple(emptied))


def _path(name: str) -> str:
    parts = [part for part in name.split("/") if part not in ("", ".")]
    if ".." in parts or len(name) > PATH_CHARACTERS_MAX:
        raise InputError(f"{name[:80]}: a path that leads out of the image, or is longer than {PATH_CHARACTERS_MAX}")
    return "/".join(parts)


def _entry(tar: tarfile.TarFile, member: tarfile.TarInfo, path: str, kept: KeptContents | None) -> Entry:
    if member.isdir():
        return Entry(path, contents.FOLDER)
    if member.issym():
        return Entry(path, contents.SYMBOLIC_LINK, target=member.linkname[:PATH_CHARACTERS_MAX])
    if member.islnk():
        return Entry(path, contents.HARD_LINK, target=_path(member.linkname))
    if not member.isreg():
        return Entry(path, contents.OTHER)
    content = tar.extractfile(member)
    assert content is not None  # of a regular file there is one
    return _file(content, path, kept)


def _file(content: IO[bytes], path: str, kept: KeptContents | None) -> Entry:
    """The entry of a regular file, of which no more is read than is needed."""
    head = content.read(len(ELF))
    is_elf = head == ELF
    folder = kept.folder if kept and kept.wanted(path, head) else None
    text = ""
    if contents.states_packages(path):
        head += content.read(TEXT_BYTES_MAX)
        if len(head) > TEXT_BYTES_MAX:
            raise InputError(f"/{path}: a list of packages of more than {TEXT_BYTES_MAX} bytes; it is not read")
        text = contents.stated_text(path, head)
    elif not is_elf and folder is None:
        return Entry(path, contents.FILE)
    return Entry(path, contents.FILE, sha256=_copied(head, content, folder), is_elf=is_elf, text=text)


def _copied(head: bytes, content: IO[bytes], folder: Path | None) -> str:
    """SHA-256 of `head` and what follows it, which goes to a file of that name in `folder`."""
    digest = sha256(head)
    if folder is None:
        while block := content.read(BLOCK_BYTES):
            digest.update(block)
        return digest.hexdigest()
    with tempfile.NamedTemporaryFile(dir=folder, delete=False) as out:
        out.write(head)
        while block := content.read(BLOCK_BYTES):
            digest.update(block)
            out.write(block)
    Path(out.name).replace(folder / digest.hexdigest())
    return digest.hexdigest()
