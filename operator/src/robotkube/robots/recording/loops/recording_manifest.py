"""The manifest of one recording while it is written: a chain through the journal, its key and seal noted on the volume.

The key is drawn when the recording begins, signs once, and is forgotten with that: it is never written anywhere. Its
public half stands in the database, on the volume claim (`<recording>/<life>.manifest`) and in the log. So does, in the
first two, the head of the chain: behind each part that the database has acknowledged a killed writer's is known.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robotkube.robots.recording.core.documents import INDEX, MANIFESTS, SAMPLES, SEGMENTS, Write
from robotkube.robots.recording.core.manifests import (
    ENTRY_BYTES,
    NAME_BYTES,
    PART_ENTRIES_MAX,
    Chain,
    PriorManifest,
    is_final,
    name_of,
)
from robotkube.robots.recording.core.one_time_signatures import IDENTIFIER_BYTES, SEED_BYTES, OneTimeKey
from robotkube.robots.recording.core.writer_manifests import read_manifests
from robotkube.robots.recording.core.writer_notes import HEAD, PART, WriterNotes, by_life, noted_end
from robotkube.robots.recording.loops.destinations import RecorderPlace
from robotkube.robots.recording.loops.journal import Journal
from robotkube.robots.recording.loops.offers import PriorContents

if TYPE_CHECKING:
    from robotkube.robots.recording.ports import WritableVolume

PART_SECONDS = 5.0
_WRITE_BYTES = 3000

log = logging.getLogger(__name__)


class RecordingManifest:
    """The manifest of one writer, for the recorder's own thread: `begin`, then the rest, at last `seal`. The journal's
    calls `acknowledge`."""

    def __init__(self, recording: str, life: int, journal: Journal, place: RecorderPlace) -> None:
        self._recording = recording
        self._life = life
        self._journal = journal
        self._place = place
        self._chain: Chain | None = None
        self._secret: OneTimeKey | None = None
        self._before: list[PriorManifest] = []
        self._unfinished: set[str] = set()
        self._lines: list[str] = []
        self._acknowledged: tuple[int, str] = (0, "")
        self._noted = self._acknowledged
        self._part_due_at = place.monotonic() + PART_SECONDS
        self._problem = ""

    def begin(self) -> Write:
        """Draw the key; the write that makes the manifest's document."""
        self._secret = OneTimeKey(self._place.draw(IDENTIFIER_BYTES), self._place.draw(SEED_BYTES))
        key = self._secret.public.hex()
        self._chain = chain = Chain(self._recording, self._life, self._place.volume, key)
        self._lines.append(_line(recording=self._recording, life=self._life, key=key))
        log.info("recording %s: manifest begun life=%d key=%s", self._recording, self._life, key)
        return Write(MANIFESTS, chain.begun["_id"], chain.begun, size=_WRITE_BYTES)

    def add(self, writes: Iterable[Write]) -> None:
        """Add the new documents among these writes, which the journal has."""
        for write in writes:
            if write.collection in (SAMPLES, INDEX) and not write.update:
                self.add_document(write.collection, write.document)

    def add_document(self, collection: str, document: Mapping[str, Any], adopted: bool = False) -> None:
        """Add one document, with its `_id`, as it is for good."""
        assert self._chain is not None
        self._chain.add(collection, document, adopted)
        if self._chain.waiting >= PART_ENTRIES_MAX:
            self._write_part(self._chain)

    def begin_segment(self, segment: str) -> None:
        """Note a segment that has to get an end."""
        self._unfinished.add(segment)

    def end_segment(self, segment: str) -> None:
        """Note that a segment has its end."""
        self._unfinished.discard(segment)

    def acknowledge(self, write: Write) -> None:
        """Note that the database has a document: the head behind a part goes to the volume by the next turn."""
        if write.collection == MANIFESTS and write.document["life"] == self._life and "number" in write.document:
            self._acknowledged = write.document["number"], write.document["head"]

    def adopt(self, prior: PriorContents) -> None:
        """Go on behind earlier writers: with their manifests as they are, or as their notes have them, and with what no
        part of them has."""
        covered: set[bytes] = set()
        last: dict[int, PriorManifest] = {}
        for document in prior.manifests:
            life = int(document["life"])
            last.setdefault(life, PriorManifest(life, 0, ""))
            if "number" in document:
                last[life] = max(last[life], PriorManifest(life, document["number"], document["head"]), key=_parts)
                covered.update(_names(document))
        last |= self._as_noted(prior)
        self._before = [last[life] for life in sorted(last) if life != self._life]
        for collection, document in prior.stored if self._chain is not None else ():
            if is_final(collection, document):
                if name_of(collection, document) not in covered:
                    self.add_document(collection, document, adopted=True)
            elif collection == SEGMENTS:
                self.begin_segment(document["segment"])

    def _as_noted(self, prior: PriorContents) -> dict[int, PriorManifest]:
        """The ends of earlier writers' chains of which the database has something else than their notes say."""
        known = {manifest.life: manifest for manifest in read_manifests(self._recording, prior.manifests)}
        noted: dict[int, PriorManifest] = {}
        for life, notes in prior.notes.items():
            end = noted_end(known.get(life), notes)
            if end is not None and life != self._life:
                noted[life] = PriorManifest(life, *end)
                parts, head = end
                log.error(
                    "recording %s: the database lacks what writer %d noted on %s: parts=%d head=%s",
                    self._recording, life, self._place.volume, parts, head,
                )  # fmt: skip
        return noted

    def earlier_notes(self) -> dict[int, WriterNotes]:
        """What earlier writers have noted on the volume; nothing where it cannot be read. The journal's thread calls
        it."""
        volume_claim = self._journal.volume_claim
        try:
            return by_life(volume_claim.noted_of(self._recording)) if volume_claim is not None else {}
        except OSError as error:
            log.warning("recording %s: notes on %s are not compared: %s", self._recording, self._place.volume, error)
            return {}

    def turn(self, volume_claim: WritableVolume | None) -> None:
        """Write a part now and then, and note on the volume what is not noted there yet."""
        now = self._place.monotonic()
        if self._chain is not None and self._chain.waiting and now >= self._part_due_at:
            self._part_due_at = now + PART_SECONDS
            self._write_part(self._chain)
        self._note(volume_claim)

    def seal(self, document: Mapping[str, Any] | None, volume_claim: WritableVolume | None) -> None:
        """Write the last part and the seal, and forget the key. `document`: the recording's own as it ends; None when
        nobody here knows what an earlier writer has left."""
        if self._chain is None or self._secret is None:
            return
        if self._chain.waiting:
            self._write_part(self._chain)
        statement = self._chain.statement(document, self._before, self._unfinished)
        sealed = {"statement": statement, "signature": self._secret.sign(statement.encode()).hex()}
        self._secret = None
        name = self._chain.begun["_id"]
        self._journal.add([Write(MANIFESTS, name, sealed, update=True, size=_WRITE_BYTES)])
        self._lines.append(_line(**sealed))
        self._note(volume_claim)
        log.info("recording %s: sealed documents=%d head=%s", self._recording, self._chain.documents, self._chain.head)

    def _write_part(self, chain: Chain) -> None:
        part = chain.cut()
        size = _WRITE_BYTES + sum(len(group["entries"]) for group in part["groups"])
        self._journal.add([Write(MANIFESTS, part["_id"], part, size=size)])

    def _note(self, volume_claim: WritableVolume | None) -> None:
        acknowledged = self._acknowledged
        heads = [_head_line(*acknowledged)] if acknowledged != self._noted else []
        if not (heads or self._lines) or volume_claim is None:
            return
        try:
            volume_claim.note(self._recording, f"{self._life}", [*self._lines, *heads])
        except OSError as error:
            if str(error) != self._problem:
                log.warning("recording %s: key and seal are not on the volume yet: %s", self._recording, error)
            self._problem = str(error)
            return
        self._lines = []
        self._noted = acknowledged


def _head_line(part: int, head: str) -> str:
    return _line(**{PART: part, HEAD: head})


def _line(**values: Any) -> str:
    return json.dumps(values, sort_keys=True)


def _parts(manifest: PriorManifest) -> int:
    return manifest.parts


def _names(part: Mapping[str, Any]) -> Sequence[bytes]:
    entries = [bytes(group["entries"]) for group in part["groups"]]
    return [data[start : start + NAME_BYTES] for data in entries for start in range(0, len(data), ENTRY_BYTES)]
