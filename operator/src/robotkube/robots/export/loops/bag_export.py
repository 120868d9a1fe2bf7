"""Exporting a recording: its messages read back, proved by their digests, and written in the order of reception.

Small messages wait in a staging file, so that memory holds only their places. Large ones are read when their turn
comes. What cannot be read or is not what was recorded is left out and reported.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from robotkube.errors import InputError, UnavailableError
from robotkube.robots.bags.core.playback import BagTopic
from robotkube.robots.recording.core.audits import add_up
from robotkube.robots.recording.core.documents import SegmentPlace
from robotkube.robots.recording.core.verification import without_any
from robotkube.robots.recording.ports import RecordingReader, SegmentReader
from robotkube.robots.ros.core.gaps import Gap, Interval
from robotkube.robots.ros.core.topic_patterns import TopicPattern

MESSAGES_MAX = 20_000_000
STAMP_MIN = -(2**63)
STAMP_MAX = 2**63 - 1
PROBLEMS_MAX = 100
DEPTH_DEFAULT = 1000
DEPTH_LATCHED = 1


class StagingFile(Protocol):
    """A staging file, which keeps bytes for a while. OSError: there is no space."""

    def put(self, data: bytes) -> int:
        """Keep bytes; their place."""
        ...

    def get(self, place: int, size: int) -> bytes:
        """The bytes that were kept at a place."""
        ...


class Target(Protocol):
    """The bag that the messages are written to."""

    def add(self, topic: str, moment: int, data: bytes, stamp: int | None = None) -> None:
        """Add one message: when it was received and its stamp, ns."""
        ...


@dataclass(frozen=True)
class Selection:
    """The messages to export: topics by name or pattern, all when there are none, and stamps, both ends included.
    Latched topics are always whole: what they say holds all the time."""

    topics: tuple[TopicPattern, ...] = ()
    first: int = STAMP_MIN
    last: int = STAMP_MAX

    def has(self, topic: str) -> bool:
        """Return whether the topic is chosen."""
        return not self.topics or any(pattern.agent(topic) is not None for pattern in self.topics)


class _Entry(NamedTuple):
    """A message and where it is: in the staging file at `place`, or in a segment."""

    received: int
    stamp: int
    topic: str
    sha256: str
    size: int
    place: int
    volume: str = ""
    segment: str = ""


@dataclass
class Export:
    """A recording that is about to be exported. `entries` are in the order of reception; `silent`: topics, names or
    patterns, that the recording lists and has no message of."""

    topics: Sequence[BagTopic]
    entries: Sequence[_Entry]
    silent: Sequence[str] = ()
    left_out: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)

    def leave_out(self, entry: _Entry, reason: str) -> None:
        """Count a message that is not exported, and say why of the first ones."""
        self.left_out[entry.topic] += 1
        if len(self.problems) < PROBLEMS_MAX:
            self.problems.append(f"{entry.topic} at {entry.stamp}: {reason}")


def first_stamp(reader: RecordingReader, recording: Mapping[str, Any]) -> int:
    """The recording's begin, ns: the least stamp that its audits know of, without latched topics: they are older."""
    recorded = _RecordedTopics(recording.get("topics") or {})
    windows = [
        audit["window"]
        for audit in reader.audits(str(recording["_id"]))
        if audit.get("window") and recorded.windowed(audit["topic"])
    ]
    return min((first for first, _ in windows), default=int(recording.get("started") or 0))


def prepare(
    reader: RecordingReader, recording: Mapping[str, Any], selection: Selection, staging: StagingFile
) -> Export:
    """The recording's chosen messages, ready to be written; `recording` is its document. InputError when nothing is
    chosen, something that is not there, or too much."""
    recorded = _RecordedTopics(recording.get("topics") or {})
    entries: list[_Entry] = []
    for entry in _entries(reader, str(recording["_id"]), selection, recorded, staging):
        entries.append(entry)
        if len(entries) > MESSAGES_MAX:
            raise InputError(f"more than {MESSAGES_MAX} messages; export a part with --from and --to")
    recorded.require(str(recording["_id"]), selection, bool(entries))
    entries.sort(reverse=True)
    once = {(entry.topic, entry.stamp, entry.sha256): entry for entry in entries}  # some may be stored twice
    entries = list(reversed(once.values()))
    names = sorted({entry.topic for entry in entries})
    silent = () if selection.topics else recorded.silent()
    return Export([recorded.topic(name) for name in names], entries, silent)


def gaps_of(reader: RecordingReader, recording: str, selection: Selection) -> list[Gap]:
    """The gaps that the recording's audits know of in what is chosen, by topic and oldest first."""
    sums = add_up(reader.audits(recording))
    gaps = [gap for topic, audit in sums.items() if selection.has(topic) for gap in audit.gaps]
    chosen = [gap for gap in gaps if gap.last >= selection.first and gap.first <= selection.last]
    return sorted(chosen, key=lambda gap: (gap.topic, gap.first, gap.last))


def write(export: Export, segments: SegmentReader, staging: StagingFile, target: Target) -> None:
    """Write all messages whose bytes are what was recorded; the others are counted in `export`."""
    for entry in export.entries:
        if not (0 <= entry.stamp <= STAMP_MAX and 0 <= entry.received <= STAMP_MAX):
            export.leave_out(entry, "a bag has no times before 1970")
            continue
        try:
            data = _data(entry, segments, staging)
        except UnavailableError as error:
            export.leave_out(entry, str(error))
            continue
        if hashlib.sha256(data).hexdigest() != entry.sha256:
            export.leave_out(entry, "its bytes are not those that were recorded")
            continue
        target.add(entry.topic, entry.received, data, entry.stamp)


def _data(entry: _Entry, segments: SegmentReader, staging: StagingFile) -> bytes:
    if not entry.volume:
        return staging.get(entry.place, entry.size)
    return segments.read(entry.volume, SegmentPlace(entry.segment, entry.place), entry.size)


class _RecordedTopics:
    """The topics of a recording's document, by pattern."""

    def __init__(self, documents: Mapping[str, Mapping[str, Any]]) -> None:
        self._patterns = [(TopicPattern(text), document) for text, document in documents.items()]
        self._topics: dict[str, BagTopic] = {}
        self._spans: dict[str, Interval] = {}

    def windowed(self, name: str) -> bool:
        """Return whether a topic is one of the document, and no latched one."""
        fitting = (document for pattern, document in self._patterns if pattern.agent(name) is not None)
        return not next(fitting, {"latched": True}).get("latched")

    def silent(self) -> list[str]:
        """The names and patterns of which nothing was there."""
        return without_any([pattern.text for pattern, _ in self._patterns], self._spans)

    def topic(self, name: str) -> BagTopic:
        """A topic with its type and QoS profile."""
        if name not in self._topics:
            fitting = (document for pattern, document in self._patterns if pattern.agent(name) is not None)
            document = next(fitting, None)
            if document is None:
                raise InputError(
                    f"the recording holds {name}, which its document does not name; it cannot be exported; "
                    "choose others with --topics"
                )
            latched = bool(document.get("latched"))
            durability, depth = ("transient_local", DEPTH_LATCHED) if latched else ("volatile", DEPTH_DEFAULT)
            self._topics[name] = BagTopic(name, str(document["type"]), "reliable", durability, depth)
        return self._topics[name]

    def chosen(self, topic: str, stamp: int, selection: Selection) -> bool:
        """Remember that a message is there; whether it belongs to the selection."""
        first, last = self._spans.get(topic, (stamp, stamp))
        self._spans[topic] = (min(first, stamp), max(last, stamp))
        if not selection.has(topic):
            return False
        return self.topic(topic).latched or selection.first <= stamp <= selection.last

    def require(self, recording: str, selection: Selection, chosen: bool) -> None:
        """Check that the selected topics are there and something was `chosen`; InputError says what is there."""
        absent = [
            pattern.text for pattern in selection.topics if all(pattern.agent(name) is None for name in self._spans)
        ]
        if chosen and not absent:
            return
        held = "; ".join(f"{name} from {first} to {last}" for name, (first, last) in sorted(self._spans.items()))
        what = f"there is nothing of {', '.join(absent)}" if absent else "no message is chosen by --from and --to"
        raise InputError(f"{recording}: {what}; it holds (stamps in ns): {held or 'no messages'}")


def _entries(
    reader: RecordingReader, recording: str, selection: Selection, recorded: _RecordedTopics, staging: StagingFile
) -> Iterator[_Entry]:
    for bucket in reader.buckets(recording):
        topic = bucket["topic"]
        for sample in bucket["samples"]:
            if recorded.chosen(topic, sample["stamp"], selection):
                data = bytes(sample["data"])
                place = staging.put(data)
                yield _Entry(sample["received"], sample["stamp"], topic, sample["sha256"], len(data), place)
    for entry in reader.index(recording):
        if recorded.chosen(entry["topic"], entry["stamp"], selection):
            yield _Entry(
                entry["received"], entry["stamp"], entry["topic"], entry["sha256"], entry["size"], entry["offset"],
                entry["volume"], entry["segment"],
            )  # fmt: skip
