"""The verification of a recording's manifests: that its documents are those that its writers sealed, all of them. Pure.

A writer's manifest counts when its chain is whole and its seal holds, or when a later writer that sealed went on behind
it. Key, heads and seal are compared with what the writer noted on its volume.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.robots.recording.core.documents import AUDITS, SEGMENTS
from robotkube.robots.recording.core.manifests import (
    ENTRY_BYTES,
    NAME_BYTES,
    digest_of_recording,
    entry_of,
    is_journals,
)
from robotkube.robots.recording.core.writer_manifests import WriterManifest
from robotkube.robots.recording.core.writer_notes import WriterNotes, contradiction, with_noted_seal

Notes = Mapping[str, Mapping[int, WriterNotes] | None]
"""Volume -> life -> what the writer noted there; None when the volume is not within reach."""

NO_MANIFEST = (
    "has no manifest: it was recorded before there were any, or its manifest and the notes on its volume are gone; "
    "nothing proves that it is whole"
)


@dataclass
class SealExamination:
    """What manifests say of a recording: `check` every document of it, then read the result."""

    recording: Mapping[str, Any]
    manifests: Sequence[WriterManifest]
    notes: Notes
    keys: Collection[str] = ()
    _allowed: dict[bytes, set[bytes]] = field(default_factory=dict)
    _sealed: dict[bytes, tuple[str, str]] = field(default_factory=dict)
    _present: set[bytes] = field(default_factory=set)
    _changed: list[str] = field(default_factory=list)
    _unknown: list[str] = field(default_factory=list)
    _given_up: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        name = str(self.recording["_id"])
        self.manifests = [with_noted_seal(name, manifest, self._notes_of(manifest)) for manifest in self.manifests]
        counted = {manifest.life for manifest in self.manifests if manifest.sealed or self._continued(manifest)}
        for manifest in self.manifests:
            for part in manifest.parts if manifest.life in counted else ():
                for group in part["groups"]:
                    self._allow(group)

    def _notes_of(self, manifest: WriterManifest) -> WriterNotes:
        """What the writer of a manifest has noted, as far as it is within reach."""
        return (self.notes.get(manifest.volume) or {}).get(manifest.life) or WriterNotes()

    def _allow(self, group: Mapping[str, Any]) -> None:
        data = bytes(group["entries"])
        place = str(group["collection"]), str(group["topic"])
        for start in range(0, len(data), ENTRY_BYTES):
            name = data[start : start + NAME_BYTES]
            self._allowed.setdefault(name, set()).add(data[start + NAME_BYTES : start + ENTRY_BYTES])
            self._sealed[name] = place

    def _continued(self, manifest: WriterManifest) -> bool:
        """Return whether a later writer that sealed went on behind this one, as it is, or as it was before the last
        parts that the volume has the head of: one that is deleted by force may outlive the start of the next."""
        if manifest.problem:
            return False
        parts = len(manifest.parts)
        noted = self._notes_of(manifest).last == (parts, manifest.heads[-1])
        later = [one.before for one in self.manifests if one.sealed]
        ends = [before[manifest.life] for before in later if manifest.life in before]
        return any(
            (number == parts or (noted and number < parts)) and head == (manifest.heads[number] if number else "")
            for number, head in ends
        )

    def check(self, collection: str, document: Mapping[str, Any]) -> None:
        """Compare a document with the manifests."""
        if not self.manifests or (collection == SEGMENTS and document["segment"] in self._unfinished):
            return
        if collection == AUDITS and is_journals(document):
            self._given_up[document["topic"]] += document["dropped"]
            if not _only_gives_up(document):
                self._unknown.append(document["_id"])
            return
        try:
            entry = entry_of(collection, document)
        except (KeyError, TypeError, ValueError):
            entry = b""
        name = entry[:NAME_BYTES]
        if name not in self._allowed:
            self._unknown.append(document["_id"])
            return
        self._present.add(name)
        if entry[NAME_BYTES:] not in self._allowed[name]:
            self._changed.append(document["_id"])

    @property
    def changed(self) -> Sequence[str]:
        """Documents that say something else than was sealed."""
        return self._changed

    @property
    def unknown(self) -> Sequence[str]:
        """Documents that no manifest has."""
        return self._unknown

    @property
    def missing(self) -> Counter[tuple[str, str]]:
        """The number of sealed documents that are not there, by collection and topic."""
        return Counter(place for name, place in self._sealed.items() if name not in self._present)

    @property
    def problems(self) -> list[str]:
        """What contradicts the manifests, in words."""
        problems = [*self._manifest_problems(), *self._note_problems()]
        for (collection, topic), count in sorted(self.missing.items()):
            given_up = self._given_up[topic]
            why = f"; the journal gave up {given_up} messages of it" if given_up else ""
            of = f" of {topic}" if topic else ""
            problems.append(f"{count} sealed documents of {collection}{of} are not there{why}")
        if self._changed:
            problems.append(
                f"{len(self._changed)} documents are not as they were sealed; the first: {self._changed[0]}"
            )
        if self._unknown:
            problems.append(f"{len(self._unknown)} documents are in no manifest; the first: {self._unknown[0]}")
        digest = self._last["document"] if self._last else None
        if digest is not None and digest != digest_of_recording(self.recording):
            problems.append("what the recording's own document says is not what was sealed")
        return problems

    @property
    def reservations(self) -> list[str]:
        """What cannot be said, in words, although nothing contradicts."""
        if not self.manifests:
            return [NO_MANIFEST]
        reservations = list(self._lost_parts())
        if self._last is not None and self._last["document"] is None:
            reservations.append("nobody has sealed the recording's own document: the database was away to the end")
        sealed = [manifest for manifest in self.manifests if manifest.sealed]
        for manifest in () if self.keys else sealed:
            if self._notes_of(manifest).keys:
                continue
            if self.notes.get(manifest.volume) is None:
                why = f"{manifest.volume} is not within reach (--segments <node>/<claim>=<folder>)"
            else:
                why = f"{manifest.volume} has no note of it"
            text = f"the key of writer {manifest.life} is the database's word alone: {why}"
            reservations.append(f"{text}; compare it with the writer's log, or give it by --key")
        return reservations

    def _lost_parts(self) -> Iterator[str]:
        """What writers sealed on their volumes, of which the database had less when a later writer went on."""
        known = {manifest.life: manifest for manifest in self.manifests}
        for volume, life, notes in self._noted:
            parts, _ = notes.sealed
            manifest = known.get(life)
            had = len(manifest.parts) if manifest else 0
            later = self._continued(manifest) if manifest else self._passed_over(life)
            if later and parts > had:
                yield (
                    f"writer {life} sealed {parts} parts on {volume}, of which the database had {had} when a later "
                    "writer went on: what the others were of was lost with its process, or was taken away before"
                )

    @property
    def _noted(self) -> Iterator[tuple[str, int, WriterNotes]]:
        """Volume, life and notes of every writer that has noted something within reach, on the volume that is its."""
        volumes = {manifest.life: manifest.volume for manifest in self.manifests}
        for volume, noted in self.notes.items():
            for life, notes in (noted or {}).items():
                if volume == volumes.get(life, volume):
                    yield volume, life, notes

    @property
    def _last(self) -> Mapping[str, Any] | None:
        """The statement of the last writer that sealed: the one that no other went on behind, whatever its clock
        said."""
        sealed = [manifest for manifest in self.manifests if manifest.sealed]
        followed = {life for manifest in sealed for life in manifest.before}
        return next((one.statement for one in reversed(sealed) if one.life not in followed), None)

    @property
    def _unfinished(self) -> Sequence[str]:
        return self._last["unfinished"] if self._last else ()

    def _manifest_problems(self) -> Iterable[str]:
        known = {manifest.life for manifest in self.manifests}
        for manifest in self.manifests:
            if manifest.problem:
                yield f"the manifest of writer {manifest.life} does not hold: {manifest.problem}"
            elif not (manifest.sealed or self._continued(manifest)):
                yield self._not_counted(manifest)
            if self.keys and manifest.sealed and manifest.key not in self.keys:
                yield f"the key of writer {manifest.life} is none of those given by --key"
            for life in manifest.before if manifest.sealed else ():
                if life not in known:
                    yield f"the manifest of writer {life} is gone, behind which writer {manifest.life} went on"
        for key in self.keys:
            if not self._explained(key):
                yield (
                    f"no manifest has the key {key[:16]}... that --key gives: the manifest of its writer was taken "
                    "away, or the key is of another recording"
                )

    def _not_counted(self, manifest: WriterManifest) -> str:
        later = next((one.life for one in self.manifests if one.sealed and manifest.life in one.before), None)
        if later is None:
            return f"writer {manifest.life} has not sealed what it stored, and no later one went on behind it"
        return f"the manifest of writer {manifest.life} is not the one behind which writer {later} went on"

    def _explained(self, key: str) -> bool:
        """Return whether a given key is a manifest's, or that of a writer of which nothing had come to the database."""
        return any(manifest.key == key for manifest in self.manifests) or any(
            key in notes.keys and self._passed_over(life) for _, life, notes in self._noted
        )

    def _note_problems(self) -> Iterable[str]:
        by_life = {manifest.life: manifest for manifest in self.manifests}
        for volume, life, notes in self._noted:
            manifest = by_life.get(life)
            if manifest is None:
                if self._expected(life, notes):
                    yield f"{volume} has a note of writer {life}, of which the database has no manifest"
            elif what := contradiction(manifest, notes):
                yield f"what writer {life} noted on {volume} is not what the database has: {what}"
            elif notes.seals and not (manifest.sealed or self._continued(manifest)):
                parts, _ = notes.sealed
                yield f"writer {life} sealed {parts} parts on {volume}, of which the database has {len(manifest.parts)}"

    def _passed_over(self, life: int) -> bool:
        """Return whether a later writer that sealed went on without this one, of which nothing had come to the
        database."""
        return any(
            manifest.sealed and manifest.life > life and life not in manifest.before for manifest in self.manifests
        )

    def _expected(self, life: int, notes: WriterNotes) -> bool:
        """Return whether the database should have a manifest of this writer: it had parts of it, or the writer sealed
        and nobody went on without it, or there is no manifest at all."""
        return bool(notes.heads) or (not self._passed_over(life) and (bool(notes.seals) or not self.manifests))


def _only_gives_up(audit: Mapping[str, Any]) -> bool:
    """True for an audit that says nothing but what was given up."""
    counted = sum(gap["count"] or 0 for gap in audit["gaps"])
    others = (audit["received"], audit["stored"], audit["early"], audit["duplicates"])
    return others == (0, 0, 0, 0) and audit["dropped"] == counted > 0
