"""The notes that writers leave on their volumes, read back and compared with what the database has. Pure.

A writer notes the public half of its key when it begins, the head of its chain whenever the database has acknowledged
another part, and at its end its seal. Whoever has only the database's account changes none of that.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from robotkube.robots.recording.core.writer_manifests import WriterManifest, read_statement, sealed_by

KEY, PART, HEAD, STATEMENT, SIGNATURE = "key", "part", "head", "statement", "signature"


@dataclass(frozen=True)
class WriterNotes:
    """The notes of one writer. `heads`: number of a part -> head behind it, of parts that the database had; `seals`:
    statement -> signature."""

    keys: frozenset[str] = frozenset()
    heads: Mapping[int, str] = field(default_factory=dict)
    seals: Mapping[str, str] = field(default_factory=dict)

    @property
    def last(self) -> tuple[int, str]:
        """The number of parts that the database had at least, and the head behind them."""
        return max(self.heads.items(), default=(0, ""))

    @property
    def sealed(self) -> tuple[int, str]:
        """The number of parts that the seal is of, and the head behind them; zero parts when there is no seal."""
        statements = [read_statement(text) or {} for text in self.seals]
        ends = [(statement.get("parts"), str(statement.get("head"))) for statement in statements]
        return max(((parts, head) for parts, head in ends if isinstance(parts, int)), default=(0, ""))


def read_notes(lines: Iterable[str]) -> WriterNotes:
    """The notes in the lines of a writer; what is no such line says nothing."""
    values = [read_statement(line) or {} for line in lines]
    return WriterNotes(
        keys=frozenset(str(one[KEY]) for one in values if KEY in one),
        heads={one[PART]: str(one[HEAD]) for one in values if isinstance(one.get(PART), int) and HEAD in one},
        seals={str(one[STATEMENT]): str(one.get(SIGNATURE)) for one in values if STATEMENT in one},
    )


def by_life(noted: Mapping[str, Iterable[str]]) -> dict[int, WriterNotes]:
    """The notes of all writers of a recording on one volume. `noted`: name of a writer's file -> its lines."""
    return {int(life): read_notes(lines) for life, lines in noted.items() if life.isdecimal()}


def contradiction(manifest: WriterManifest, notes: WriterNotes) -> str:
    """What the notes of a writer have otherwise than its manifest in the database, in words; empty when nothing. That
    the database lacks the seal, or parts that nobody has seen there, is none: a kill costs what was on its way."""
    had, _ = notes.last
    parts, head = notes.sealed
    if notes.keys - {manifest.key}:
        return "another key"
    for number, noted in sorted({**notes.heads, **({parts: head} if parts else {})}.items()):
        if number < len(manifest.heads) and manifest.heads[number] != noted:
            return f"another head behind part {number}"
    if had > len(manifest.parts):
        return f"{had} parts that the database had, of which it has {len(manifest.parts)}"
    if parts and parts < len(manifest.parts):
        return f"a seal over {parts} parts, of which the database has {len(manifest.parts)}"
    return "another seal" if manifest.text and set(notes.seals) - {manifest.text} else ""


def noted_end(manifest: WriterManifest | None, notes: WriterNotes) -> tuple[int, str] | None:
    """The number of parts and the head of a writer's chain by its notes, where the database has another chain of it or
    lacks what it had; None where it does not. A later writer goes on behind what was noted."""
    if manifest is None:
        return notes.last if notes.heads else None
    return max(notes.last, notes.sealed) if contradiction(manifest, notes) else None


def with_noted_seal(recording: str, manifest: WriterManifest, notes: WriterNotes) -> WriterManifest:
    """The manifest with the seal of its notes, where the database has none and that one is of this very chain."""
    for text, signature in notes.seals.items() if not manifest.text else ():
        sealed = sealed_by(recording, manifest, text, signature)
        if sealed.sealed:
            return sealed
    return manifest
