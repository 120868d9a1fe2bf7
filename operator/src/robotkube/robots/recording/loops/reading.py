"""Reading recordings back: which there are, and whether one agrees with its sources' ledgers.

Everything is computed from the stored bytes: small messages from the buckets, large ones from their segments.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from robotkube.errors import DocumentError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.robots.recording.core.audits import AuditSum, add_up
from robotkube.robots.recording.core.documents import (
    AUDITS,
    INDEX,
    SAMPLES,
    SEGMENTS,
    SegmentPlace,
    bucket_is_whole,
    entry_is_whole,
)
from robotkube.robots.recording.core.ledgers import (
    LATENCY_NS_MAX,
    LedgerComparison,
    LedgerLine,
    StoredMessage,
    compare,
    published_digest,
)
from robotkube.robots.recording.core.seals import SealExamination
from robotkube.robots.recording.core.writer_manifests import read_manifests
from robotkube.robots.recording.core.writer_notes import WriterNotes, by_life
from robotkube.robots.recording.ports import RecordingReader, SegmentReader

NOTHING: Mapping[str, Collection[str]] = {}
"""No ledger."""


def list_recordings(reader: RecordingReader) -> list[dict[str, Any]]:
    """The recordings, oldest first: id, times, provenance, volumes."""
    return [dict(document) for document in reader.recordings()]


def stored_messages(
    reader: RecordingReader,
    segments: SegmentReader,
    recording: str,
    window: tuple[int, int] | None = None,
    changed: Callable[[str], None] = lambda _: None,
    seen: Callable[[str, Mapping[str, Any]], None] = lambda _, __: None,
    published: Mapping[str, Collection[str]] = NOTHING,
) -> Iterator[StoredMessage]:
    """Every stored message of a recording whose stamp is in `window`, with the hash of the bytes as they are now.

    `changed` gets the `_id` of every document whose stamps or digests are not those that it was stored with, `seen`
    the collection and the document of each. `published`: topic -> the digests that its ledger has."""
    for bucket in reader.buckets(recording):
        seen(SAMPLES, bucket)
        if not bucket_is_whole(bucket):
            changed(bucket["_id"])
        for sample in bucket["samples"]:
            if _within(sample, window):
                data = bytes(sample["data"])
                yield _stored(bucket["topic"], sample, data, published)
    for entry in reader.index(recording):
        seen(INDEX, entry)
        if not entry_is_whole(entry):
            changed(entry["_id"])
        if _within(entry, window):
            yield _large(segments, entry, published)


def first_stored(reader: RecordingReader, recording: str) -> dict[str, int]:
    """Topic -> when the first of its large messages was stored: segment synchronised and entry acknowledged, ns."""
    first: dict[str, int] = {}
    for entry in reader.index(recording):
        if entry.get("stored") is not None:
            first[entry["topic"]] = min(first.get(entry["topic"], entry["stored"]), entry["stored"])
    return first


def first_stamps(reader: RecordingReader, recording: str) -> dict[str, int]:
    """Topic -> the least stamp of its large messages, ns. The later of two begins the window of the pair."""
    first: dict[str, int] = {}
    for entry in reader.index(recording):
        first[entry["topic"]] = min(first.get(entry["topic"], entry["stamp"]), entry["stamp"])
    return first


def verify(
    reader: RecordingReader,
    segments: SegmentReader,
    recording: str,
    ledgers: Mapping[str, Sequence[LedgerLine]],
    window: tuple[int, int],
) -> LedgerComparison:
    """Compare the recording with the ledgers of its topics, within a window of stamps (ns, both ends included)."""
    stored = stored_messages(reader, segments, recording, window, published=published_digests(ledgers))
    return compare(recording, ledgers, stored, window)


def published_digests(ledgers: Mapping[str, Sequence[LedgerLine]]) -> dict[str, Collection[str]]:
    """Topic -> the digests of its ledger."""
    return {topic: frozenset(line.sha256 for line in lines) for topic, lines in ledgers.items()}


def audits(reader: RecordingReader, recording: str) -> dict[str, AuditSum]:
    """Topic -> the sum of what all writers of the recording did with it, by their audits."""
    return add_up(reader.audits(recording))


def wrong_segments(reader: RecordingReader, segments: SegmentReader, recording: str) -> list[str]:
    """The problems of a recording's files, in words: not finished, not within reach, or changed since they were."""
    problems = []
    for entry in reader.segments(recording):
        if not entry["sha256"]:
            problems.append(f"{entry['volume']}: {entry['segment']}: is not finished")
            continue
        try:
            digest = segments.digest(entry["volume"], entry["segment"])
        except UnavailableError as error:
            problems.append(str(error))
            continue
        if digest != (entry["sha256"], entry["size"]):
            problems.append(f"{entry['volume']}: {entry['segment']}: is not the file that was finished")
    return problems


def begin_examination(
    reader: RecordingReader, segments: SegmentReader, document: Mapping[str, Any], keys: Collection[str] = ()
) -> SealExamination:
    """The examination of a recording's manifests, which has seen its audits and segments; `stored_messages` shows it
    the rest. `document`: the recording's own."""
    recording = str(document["_id"])
    manifests = read_manifests(recording, reader.manifests(recording))
    volumes = sorted({*(document.get("volumes") or ()), *(manifest.volume for manifest in manifests)} - {""})
    notes = {volume: _notes(segments, volume, recording) for volume in volumes}
    examination = SealExamination(document, manifests, notes, keys)
    for audit in reader.audits(recording):
        examination.check(AUDITS, audit)
    for segment in reader.segments(recording):
        examination.check(SEGMENTS, segment)
    return examination


def _notes(segments: SegmentReader, volume: str, recording: str) -> dict[int, WriterNotes] | None:
    try:
        noted = segments.notes(volume, recording)
    except UnavailableError:
        return None
    return by_life(noted)


def read_ledger(lines: Iterable[str], where: str) -> list[LedgerLine]:
    """The lines of a player's ledger; DocumentError when it is not complete (its last line says how many there are)."""
    ledger: list[LedgerLine] = []
    for number, line in enumerate(lines, start=1):
        try:
            values = read_json(line)
            if values.get("end"):
                if values["count"] != len(ledger):
                    raise DocumentError(where, [f"line {number}: has {len(ledger)} messages, says {values['count']}"])
                return ledger
            ledger.append(LedgerLine(int(values["sequence"]), int(values["stamp"]), str(values["sha256"])))
        except (ValueError, KeyError, AttributeError, TypeError) as error:
            raise DocumentError(where, [f"line {number}: is no ledger line ({error})"]) from error
    raise DocumentError(where, ["has no end line: its player is still running or was killed"])


def _within(message: Mapping[str, Any], window: tuple[int, int] | None) -> bool:
    """True for a stamp in the window; one without its own may have been due in it, and be received later."""
    stamp = message["stamp"]
    later = LATENCY_NS_MAX if stamp == message.get("received") else 0
    return window is None or window[0] <= stamp <= window[1] + later


def _large(
    segments: SegmentReader, entry: Mapping[str, Any], published: Mapping[str, Collection[str]]
) -> StoredMessage:
    size = entry["size"]
    try:
        data = segments.read(entry["volume"], SegmentPlace(entry["segment"], entry["offset"]), size)
    except UnavailableError as error:
        return StoredMessage(entry["topic"], entry["stamp"], "", entry["sha256"], size, str(error))
    return _stored(entry["topic"], entry, data, published)


def _stored(
    topic: str, message: Mapping[str, Any], data: bytes, published: Mapping[str, Collection[str]]
) -> StoredMessage:
    digest = hashlib.sha256(data).hexdigest()
    known = published_digest(data, digest, published.get(topic, ()))
    return StoredMessage(
        topic, message["stamp"], digest, message["sha256"], len(data), "", message.get("received"), known
    )
