"""The documents of a recording in storage.

Pure. Identifiers are derived from content, so writing something a second time changes nothing
(docs/reference/contracts.md, "Recording storage"). Stamps and times are integers in ns since 1970.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

DOCUMENT = "document"
SEGMENT = "segment"
RECORDINGS = "recordings"
SAMPLES = "samples"
INDEX = "segments_index"
SEGMENTS = "segments"
AUDITS = "audits"
MANIFESTS = "manifests"
COLLECTIONS = (RECORDINGS, SAMPLES, INDEX, SEGMENTS, AUDITS, MANIFESTS)
SECOND_NS = 1_000_000_000
DOCUMENT_BYTES_MAX = 128 * 1024
BUCKET_BYTES_MAX = 512 * 1024


@dataclass(frozen=True, slots=True)
class Received:
    """A message to store. `sha256`: hex digest of `data`, the whole serialised message."""

    topic: str
    stamp: int
    received: int
    sha256: str
    data: bytes


@dataclass(frozen=True)
class SegmentPlace:
    """The place of a large message: file below the volume claim, and the byte offset of its MCAP message record."""

    segment: str
    offset: int


@dataclass(frozen=True)
class ClosedSegment:
    """A segment that nobody writes any more. `sha256`: hex digest of the whole file; `cut`: bytes of an unfinished
    record that were cut off its end because its writer was killed."""

    segment: str
    sha256: str
    size: int
    messages: int
    cut: int = 0


@dataclass(frozen=True)
class SegmentMessage:
    """A large message in a segment: what its index entry needs, without its bytes."""

    topic: str
    stamp: int
    received: int
    sha256: str
    size: int
    place: SegmentPlace


@dataclass(frozen=True)
class Write:
    """One change of the recordings' database: `document` is put at `_id` `id` if nothing is there; with `update` its
    fields are set in the document that is there (`a.b`: the field b of its field a), and the values of `add` are added
    to its lists that lack them. Doing it twice changes nothing."""

    collection: str
    id: str
    document: Mapping[str, Any]
    update: bool = False
    size: int = 0
    add: Mapping[str, Any] = field(default_factory=dict)


def messages_of(write: Write) -> tuple[str, list[int]]:
    """Topic and stamps of the messages that are lost without this write; no stamps when it carries none."""
    if write.update or write.collection not in (SAMPLES, INDEX):
        return "", []
    if write.collection == INDEX:
        return write.document["topic"], [write.document["stamp"]]
    return write.document["topic"], [sample["stamp"] for sample in write.document["samples"]]


def bucket_documents(recording: str, messages: Sequence[Received]) -> list[dict[str, Any]]:
    """One bucket per topic and whole second of stamp, oldest first; `_id` ends with a digest of its content.

    A second with more than BUCKET_BYTES_MAX has several."""
    buckets: dict[tuple[str, int, int], list[Received]] = {}
    part = size = 0
    for message in sorted(messages, key=lambda message: (message.topic, message.stamp)):
        if size + len(message.data) > BUCKET_BYTES_MAX:
            part += 1
            size = 0
        size += len(message.data)
        buckets.setdefault((message.topic, message.stamp // SECOND_NS, part), []).append(message)
    return [_bucket(recording, topic, second, content) for (topic, second, _), content in buckets.items()]


def _bucket(recording: str, topic: str, second: int, messages: Sequence[Received]) -> dict[str, Any]:
    content = _content((m.stamp, m.sha256) for m in messages)
    samples = [{"stamp": m.stamp, "received": m.received, "sha256": m.sha256, "data": m.data} for m in messages]
    return {
        "_id": f"{recording}/{topic}/{second}/{content}",
        "recording": recording,
        "topic": topic,
        "second": second,
        "samples": samples,
    }


def _content(samples: Iterable[tuple[int, str]]) -> str:
    return hashlib.sha256("".join(f"{stamp}:{sha256};" for stamp, sha256 in samples).encode()).hexdigest()[:16]


def bucket_is_whole(bucket: Mapping[str, Any]) -> bool:
    """Return whether a bucket has the stamps and digests that its `_id` was made of."""
    content = _content((sample["stamp"], sample["sha256"]) for sample in bucket["samples"])
    return bool(bucket["_id"].rpartition("/")[2] == content)


def entry_is_whole(entry: Mapping[str, Any]) -> bool:
    """Return whether an index entry has the stamp that its `_id` was made of."""
    place = f"{entry['recording']}/{entry['topic']}/{entry['stamp']}"
    return entry["_id"] in (place, f"{place}/{entry['sha256'][:16]}")


def index_document(recording: str, message: SegmentMessage, volume: str, distinct: bool = False) -> dict[str, Any]:
    """The index entry of a large message whose segment is synchronised. `volume`: `<node>/<volume claim>`.

    `stored` is null until the entry's own acknowledgement is known: a second write sets it to that time.
    `distinct`: another message of the topic has the same stamp, so the digest belongs into `_id`.
    """
    suffix = f"/{message.sha256[:16]}" if distinct else ""
    return {
        "_id": f"{recording}/{message.topic}/{message.stamp}{suffix}",
        "recording": recording,
        "topic": message.topic,
        "stamp": message.stamp,
        "received": message.received,
        "sha256": message.sha256,
        "size": message.size,
        "volume": volume,
        "segment": message.place.segment,
        "offset": message.place.offset,
        "stored": None,
    }


def resumed_fields(document: Mapping[str, Any]) -> dict[str, Any]:
    """The fields that a writer sets in the recording's document that an earlier one has made: it is open again, and has
    the topics of both. ROS names hold no dots."""
    topics = {f"topics.{name}": topic for name, topic in (document.get("topics") or {}).items()}
    renewed = {name: document[name] for name in ("causes", "definitions") if name in document}
    return {"ended": None, **renewed, **topics}


def segment_document(recording: str, closed: ClosedSegment, volume: str) -> dict[str, Any]:
    """The document of a whole file; `_id` names its place."""
    return {
        "_id": f"{volume}/{closed.segment}",
        "recording": recording,
        "volume": volume,
        "segment": closed.segment,
        "sha256": closed.sha256,
        "size": closed.size,
        "messages": closed.messages,
        "cut": closed.cut,
    }


class Duplicates:
    """The messages that a recording holds, so that none is stored twice: per topic the latest `stamps_max` stamps."""

    def __init__(self, stamps_max: int = 100_000) -> None:
        self._stamps_max = stamps_max
        self._topics: dict[str, dict[int, tuple[int, ...]]] = {}
        self.dropped = 0

    def fresh(self, topic: str, stamp: int) -> bool:
        """Return whether no message of the topic has this stamp, so that nobody needs its digest to know that it is
        new."""
        return stamp not in self._topics.get(topic, ())

    def admit(self, topic: str, stamp: int, sha256: str) -> bool:
        """Remember a message; False when it is known already."""
        stamps = self._topics.setdefault(topic, {})
        known = stamps.get(stamp, ())
        digest = int(sha256[:16], 16)
        if digest in known:
            self.dropped += 1
            return False
        stamps[stamp] = (*known, digest)
        if len(stamps) > self._stamps_max:
            del stamps[next(iter(stamps))]
        return True

    def shares_stamp(self, topic: str, stamp: int) -> bool:
        """Return whether different messages of the topic have this stamp."""
        return len(self._topics.get(topic, {}).get(stamp, ())) > 1
