"""Opening a bag by its path: its files, unpacked where they are compressed as a whole, and merged by time."""

from __future__ import annotations

import heapq
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NoReturn

from robotkube.errors import InputError
from robotkube.robots.bags.adapters.reading.compression import ZSTD, is_packed, unpack_file, unpack_message
from robotkube.robots.bags.adapters.reading.mcap_files import McapFile
from robotkube.robots.bags.adapters.reading.mcap_records import MAGIC
from robotkube.robots.bags.adapters.reading.metadata import UNKNOWN, Metadata, data_files, read_metadata
from robotkube.robots.bags.adapters.reading.sqlite_files import BEGIN, SqliteFile
from robotkube.robots.bags.core.playback import BagTopic

MCAP = "mcap"
SQLITE = "sqlite3"
PACKED = (".zstd", ".zst")
COMPLAINTS_MAX = 100
"""So many faults of a bag are reported."""
MESSAGE_BYTES_MAX = 256 * 1024 * 1024
_KINDS = {".mcap": MCAP, ".db3": SQLITE}
_ENDINGS = (*_KINDS, *(f"{ending}{packed}" for ending in _KINDS for packed in PACKED))
_BEGINS = {MAGIC: MCAP, BEGIN: SQLITE}
_ROS_1 = b"#ROSBAG"

Complain = Callable[[str], None]
Message = tuple[str, int, bytes]


def refuse(problem: str) -> NoReturn:
    """Raise InputError at the first damage: `complain` for those who need a whole bag."""
    raise InputError(f"{problem} (make the bag again, or repair it with `ros2 bag reindex` or `mcap recover`)")


class OpenBag:
    """A bag (ports Bag and BagSource). `topics`: what it holds; `definitions`: type -> definition text, as far as the
    bag brings it."""

    def __init__(self, path: Path, complain: Complain = refuse) -> None:
        self.path = path
        self._complain = complain
        self._folder: Path | None = None
        self._files: list[McapFile | SqliteFile] = []
        try:
            self._metadata = _metadata(path, complain)
            for file in self._metadata.files:
                self._add(file)
        except BaseException:
            self.close()
            raise
        if not self._files:
            raise InputError(f"{path}: none of its files can be read")
        topics: dict[str, BagTopic] = {}
        self.definitions: dict[str, str] = {}
        for opened in self._files:
            for topic in opened.topics:
                topics.setdefault(topic.name, topic)
            self.definitions |= opened.definitions
        self.topics: Sequence[BagTopic] = list(topics.values())

    @property
    def types(self) -> Mapping[str, str]:
        """Topic -> its type."""
        return {topic.name: topic.type for topic in self.topics}

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[Message]:
        """Topic, time in ns and serialised message, in the order of the times; of the topics `wanted`, all when None.

        What no topic of `wanted` needs is not read where the file has an index."""
        streams = [file.messages(wanted) for file in self._files]
        merged = streams[0] if len(streams) == 1 else heapq.merge(*streams, key=_moment)
        return merged if self._metadata.mode == "" else self._unpacked(merged)

    def close(self) -> None:
        """Close the files and delete what was unpacked."""
        for file in self._files:
            file.close()
        self._files = []
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def __enter__(self) -> OpenBag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _add(self, file: Path) -> None:
        """Open a file; one that cannot be read at all is left out when the others can."""
        try:
            self._files.append(self._open(file))
        except InputError as error:
            if len(self._metadata.files) == 1:
                raise
            self._complain(f"{error}; left out")

    def _open(self, file: Path) -> McapFile | SqliteFile:
        plain = self._plain(file)
        kind = _KINDS.get(plain.suffix) or _kind(plain, file) or self._metadata.storage
        if kind == MCAP:
            return McapFile(plain, self._complain, file)
        if kind == SQLITE:
            return SqliteFile(plain, self._complain, file, self._metadata.forms)
        storage = f"storage {kind[:40]!r} is" if kind else "is"
        raise InputError(f"{file}: {storage} none of {MCAP}, {SQLITE}; convert it: `ros2 bag convert`")

    def _plain(self, file: Path) -> Path:
        if file.suffix not in PACKED:
            return file
        try:
            if self._folder is None:
                self._folder = Path(tempfile.mkdtemp(prefix="robotkube-bag-"))
            target = self._folder / f"{len(self._files)}-{file.stem}"
            problem = unpack_file(file, target)
        except OSError as error:
            place = self._folder or f"{tempfile.gettempdir()} (choose another one by TMPDIR)"
            raise InputError(f"{file}: cannot be unpacked to {place}: {error.strerror}") from error
        if problem:
            self._complain(f"{file}: {problem}; what is before is read")
        return target

    def _unpacked(self, messages: Iterator[Message]) -> Iterator[Message]:
        everything = self._metadata.mode == "message"
        kind = self._metadata.compression or ZSTD
        for name, moment, data in messages:
            try:
                plain = unpack_message(kind, data, MESSAGE_BYTES_MAX) if everything or is_packed(data) else data
            except ValueError as error:
                self._complain(f"{self.path}: {name} at {moment}: {error}; left out")
                continue
            yield name, moment, plain


def open_bag(path: Path, complain: Complain = refuse) -> OpenBag:
    """Open a rosbag2 folder or a single file. `complain` hears, once each, of damage: when it returns, what is readable
    is used. InputError when there is nothing to read."""
    reported: set[str] = set()

    def once(problem: str) -> None:
        if problem in reported or len(reported) > COMPLAINTS_MAX:
            return
        reported.add(problem)
        more = len(reported) > COMPLAINTS_MAX
        complain(f"{path}: more than {COMPLAINTS_MAX} faults; the others are not reported" if more else problem)

    return OpenBag(path, once)


def _metadata(path: Path, complain: Complain) -> Metadata:
    """The bag's metadata by metadata.yaml; of single files, and folders without it, by the files themselves."""
    try:
        if not path.exists():
            raise InputError(f"{path}: is not there; name a rosbag2 folder or a file of a bag")
        if not path.is_dir():
            return Metadata("", (path,), UNKNOWN)
        return read_metadata(path)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); name a folder or file that you may read"
        ) from error
    except InputError as error:
        files = data_files(path, _ENDINGS)
        if not files:
            raise
        complain(f"{error}; reading {', '.join(file.name for file in files)}")
        return Metadata("", tuple(files), UNKNOWN)


def _kind(plain: Path, file: Path) -> str:
    """The kind of a file by its first bytes; empty when it is none of these."""
    try:
        if not plain.is_file():
            return ""
        with plain.open("rb") as opened:
            begin = opened.read(len(BEGIN))
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from error
    if begin.startswith(_ROS_1):
        raise InputError(f"{file}: is a bag of ROS 1; convert it: `rosbags-convert`")
    return next((kind for known, kind in _BEGINS.items() if begin.startswith(known)), "")


def _moment(message: Message) -> int:
    return message[1]
