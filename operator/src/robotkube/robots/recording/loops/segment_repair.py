"""Finishes the segments of killed writers and indexes their messages that have no index entry yet."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from robotkube.robots.recording.core.documents import (
    INDEX,
    SEGMENTS,
    ClosedSegment,
    Duplicates,
    SegmentMessage,
    Write,
    index_document,
    segment_document,
)

if TYPE_CHECKING:
    from robotkube.robots.recording.ports import RecordingStore, SegmentRepair

SEGMENT_WRITE_BYTES = INDEX_WRITE_BYTES = 500

log = logging.getLogger(__name__)


def repair_segments(repair: SegmentRepair, store: RecordingStore, volume: str) -> Iterator[Sequence[Write]]:
    """Repair unfinished segments; the writes that index their messages and note their ends, file by file.

    Each must be done before the next is asked for: a file gets its end when all of it is indexed, not before. A file
    that the volume does not let us repair is left for the next start."""
    known: dict[str, Duplicates] = {}
    for name in repair.unfinished(store.finished(volume)):
        recording = name.partition("/")[0]
        if recording not in known:
            known[recording] = _known(store, recording)
        try:
            messages = repair.messages(name)
            new = [m for m in messages if known[recording].admit(m.topic, m.stamp, m.sha256)]
            yield [index_write(recording, message, volume, known[recording]) for message in new]
            closed = repair.finish(name)
        except OSError as error:
            log.error("segment %s of %s: cannot be repaired: %s", name, volume, error)
            continue
        if closed is not None:
            numbers = closed.messages, len(new), closed.cut
            log.warning("segment %s of %s: repaired messages=%d indexed=%d cut=%d", name, volume, *numbers)
            yield segment_ended(recording, closed, volume)


def index_write(recording: str, message: SegmentMessage, volume: str, known: Duplicates) -> Write:
    """The index entry of a message that `known` has admitted."""
    distinct = known.shares_stamp(message.topic, message.stamp)
    document = index_document(recording, message, volume, distinct)
    return Write(INDEX, document["_id"], document, size=INDEX_WRITE_BYTES)


def segment_begun(recording: str, segment: str, volume: str) -> Write:
    """The document of a segment that is being written."""
    document = segment_document(recording, ClosedSegment(segment, "", 0, 0), volume)
    return Write(SEGMENTS, document["_id"], document, size=SEGMENT_WRITE_BYTES)


def segment_ended(recording: str, closed: ClosedSegment, volume: str) -> list[Write]:
    """The document of a finished segment, and the update of the one that its begin has left."""
    document = segment_document(recording, closed, volume)
    ending = {name: document[name] for name in ("sha256", "size", "messages", "cut")}
    name = document["_id"]
    update = Write(SEGMENTS, name, ending, update=True, size=SEGMENT_WRITE_BYTES)
    return [Write(SEGMENTS, name, document, size=SEGMENT_WRITE_BYTES), update]


def _known(store: RecordingStore, recording: str) -> Duplicates:
    duplicates = Duplicates()
    for topic, stamp, sha256 in store.known(recording):
        duplicates.admit(topic, stamp, sha256)
    return duplicates
