"""What is in storage: database documents and the segments they point to, read back and hashed anew.

Segments are read as MCAP from their beginning, not by the recorder's offsets, and a file whose writer was killed is
read as far as it goes.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from robotkube.robots.ros.core.common_messages import pose_position
from scenarios.generator.messages import stamp_of
from scenarios.runner.inputs import AuditGap, LedgerLine, Recording, Stored

Document = Mapping[str, Any]
FindSegment = Callable[[str, str], Path | None]
STAMP_BYTES_MIN = 12
POSE_ENDING = "/pose"


def recording(document: Document) -> Recording:
    """Provenance of a document of `recordings`."""
    provenance = document.get("provenance") or {}
    return Recording(str(document["_id"]), str(provenance.get("task", "")), str(provenance.get("event", "")))


def stored(samples: Iterable[Document], index: Iterable[Document], find_segment: FindSegment) -> tuple[Stored, ...]:
    """All messages of the documents. `find_segment` gives the file of a volume and a relative path, None when away."""
    return (*_samples(samples), *_segments(list(index), find_segment))


def gaps(audits: Iterable[Document]) -> tuple[AuditGap, ...]:
    """What the documents of `audits` name as missing; what two writers were told by the same bridge, once."""
    reported = (
        AuditGap(str(audit["recording"]), str(audit["topic"]), one["where"], one["why"], one["count"], one["first"],
                 one["last"])
        for audit in audits
        for one in audit["gaps"]
    )  # fmt: skip
    return tuple(dict.fromkeys(reported))


def ledger(lines: Iterable[Mapping[str, Any]]) -> tuple[LedgerLine, ...]:
    """The messages of a player's ledger; ValueError when it has no end or its end states another number."""
    documents = list(lines)
    messages = tuple(
        LedgerLine(int(line["sequence"]), int(line["stamp"]), str(line["sha256"]))
        for line in documents
        if "sequence" in line
    )
    if not documents or not documents[-1].get("end"):
        raise ValueError("has no end, so the player has not finished or was killed")
    if documents[-1].get("count") != len(messages):
        raise ValueError(f"states {documents[-1].get('count')} messages and holds {len(messages)}")
    return messages


def _samples(buckets: Iterable[Document]) -> Iterator[Stored]:
    for bucket in buckets:
        for sample in bucket["samples"]:
            data = bytes(sample["data"])
            yield Stored(
                str(bucket["recording"]),
                str(bucket["topic"]),
                int(sample["stamp"]),
                int(sample["received"]),
                hashlib.sha256(data).hexdigest(),
                position=_position(str(bucket["topic"]), data),
            )


def _position(topic: str, data: bytes) -> tuple[float, float] | None:
    """The position of a pose; None of another message, or one that cannot be read."""
    if not topic.endswith(POSE_ENDING):
        return None
    try:
        x, y, _ = pose_position(data)
    except ValueError:
        return None
    return x, y


def _segments(index: Iterable[Document], find_segment: FindSegment) -> Iterator[Stored]:
    """One per index entry; a message that lies in its segment more often than it is indexed gives one more each."""
    places: dict[tuple[str, str], dict[tuple[str, int], list[Document]]] = defaultdict(lambda: defaultdict(list))
    for entry in index:
        key = str(entry["topic"]), int(entry["stamp"])
        places[str(entry["volume"]), str(entry["segment"])][key].append(entry)
    for place, messages in places.items():
        held = _read(find_segment(*place))
        for key, entries in messages.items():
            digests = held.get(key, [])
            for number in range(max(len(entries), len(digests))):
                digest = digests[number] if number < len(digests) else ""
                yield _of_entry(entries[min(number, len(entries) - 1)], digest)


def _of_entry(entry: Document, digest: str) -> Stored:
    return Stored(
        str(entry["recording"]),
        str(entry["topic"]),
        int(entry["stamp"]),
        int(entry["received"]),
        digest,
        None if entry.get("stored") is None else int(entry["stored"]),
        str(entry["volume"]),
    )


def _read(path: Path | None) -> dict[tuple[str, int], list[str]]:
    """Hashes of a segment's messages by topic and stamp; empty when the file is not there."""
    digests: dict[tuple[str, int], list[str]] = defaultdict(list)
    if path is None or not path.is_file():
        return digests
    channels: dict[int, str] = {}
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if isinstance(record, Channel):
                    channels[record.id] = record.topic
                elif isinstance(record, Message) and len(record.data) >= STAMP_BYTES_MIN:
                    key = channels.get(record.channel_id, ""), stamp_of(record.data)
                    digests[key].append(hashlib.sha256(record.data).hexdigest())
        except (McapError, EOFError):
            pass  # the writer was killed: what it had finished has been read
    return digests
