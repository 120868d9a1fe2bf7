"""The verification of a recording's manifests: that its documents are those that its writers sealed, all of them. Pure.

A writer's manifest counts when its chain is whole and its seal holds, or when a later writer that sealed went on behind
it. The key of a seal is compared with what the writer noted on its volume when it began.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
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
from robotkube.robots.recording.core.writer_manifests import WriterManifest, read_statement

Notes = Mapping[str, Mapping[int, Sequence[str]] | None]
"""Volume -> life -> lines that the writer noted there; None when the volume is not within reach."""

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
        counted = {manifest.life for manifest in self.manifests if manifest.sealed or self._continued(manifest)}
        for manifest in self.manifests:
            for part in manifest.parts if manifest.life in counted else ():
                for group in part["groups"]:
                    self._allow(group)

    def _allow(self, group: Mapping[str, Any]) -> None:
        data = bytes(group["entries"])
        place = str(group["collection"]), str(group["topic"])
        for start in range(0, len(data), ENTRY_BYTES):
            name = data[start : start + NAME_BYTES]
            self._allowed.setdefault(name, set()).add(data[start + NAME_BYTES : start + ENTRY_BYTES])
            self._sealed[name] = place

    def _continued(self, manifest: WriterManifest) -> bool:
        """True when a later writer that sealed went on behind this one, as it is."""
        last = len(manifest.parts), manifest.heads[-1] if manifest.parts else ""
        return not manifest.problem and any(
            later.sealed and later.before.get(manifest.life) == last for later in self.manifests
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
        reservations = []
        if self._last is not None and self._last["document"] is None:
            reservations.append("nobody has sealed the recording's own document: the database was away to the end")
        sealed = [manifest for manifest in self.manifests if manifest.sealed]
        for manifest in () if self.keys else sealed:
            noted = self.notes.get(manifest.volume)
            if noted is None:
                why = f"{manifest.volume} is not within reach (--segments <node>/<claim>=<folder>)"
            elif _keys(noted.get(manifest.life, ())):
                continue
            else:
                why = f"{manifest.volume} has no note of it"
            text = f"the key of writer {manifest.life} is the database's word alone: {why}"
            reservations.append(f"{text}; compare it with the writer's log, or give it by --key")
        return reservations

    @property
    def _last(self) -> Mapping[str, Any] | None:
        """The statement of the last writer that sealed."""
        return next((one.statement for one in reversed(self.manifests) if one.sealed), None)

    @property
    def _unfinished(self) -> Sequence[str]:
        return self._last["unfinished"] if self._last else ()

    def _manifest_problems(self) -> Iterable[str]:
        known = {manifest.life for manifest in self.manifests}
        for manifest in self.manifests:
            if manifest.problem:
                yield f"the manifest of writer {manifest.life} does not hold: {manifest.problem}"
            elif not (manifest.sealed or self._continued(manifest)):
                yield f"writer {manifest.life} has not sealed what it stored, and no later one went on behind it"
            if self.keys and manifest.sealed and manifest.key not in self.keys:
                yield f"the key of writer {manifest.life} is none of those given by --key"
            for life in manifest.before if manifest.sealed else ():
                if life not in known:
                    yield f"the manifest of writer {life} is gone, behind which writer {manifest.life} went on"

    def _note_problems(self) -> Iterable[str]:
        by_life = {manifest.life: manifest for manifest in self.manifests}
        for volume, noted in self.notes.items():
            for life, lines in (noted or {}).items():
                manifest = by_life.get(life)
                if manifest is None:
                    if self._expected(life, lines):
                        yield f"{volume} has a note of writer {life}, of which the database has no manifest"
                elif manifest.volume == volume and _contradicts(manifest, lines):
                    yield f"what writer {life} noted on {volume}, its key or its seal, is not what the database has"

    def _expected(self, life: int, lines: Sequence[str]) -> bool:
        """True when the database should have a manifest of this writer: it sealed, or nobody did; but not when a later
        one that sealed went on without it, since nothing of it had come to the database."""
        without = any(one.sealed and one.life > life and life not in one.before for one in self.manifests)
        return not without and (bool(_seals(lines)) or not self.manifests)


def _only_gives_up(audit: Mapping[str, Any]) -> bool:
    """True for an audit that says nothing but what was given up."""
    counted = sum(gap["count"] or 0 for gap in audit["gaps"])
    others = (audit["received"], audit["stored"], audit["early"], audit["duplicates"])
    return others == (0, 0, 0, 0) and audit["dropped"] == counted > 0


def _values(lines: Sequence[str], name: str) -> list[Any]:
    statements = [read_statement(line) or {} for line in lines]
    return [statement[name] for statement in statements if name in statement]


def _keys(lines: Sequence[str]) -> list[Any]:
    return _values(lines, "key")


def _seals(lines: Sequence[str]) -> list[Any]:
    return _values(lines, "statement")


def _contradicts(manifest: WriterManifest, lines: Sequence[str]) -> bool:
    """True when the volume has another key or another seal of the writer than the database."""
    return any(key != manifest.key for key in _keys(lines)) or any(text != manifest.text for text in _seals(lines))
