"""The manifests of a recording's writers, read back: whether each chain is whole, and each seal by its key. Pure."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robotkube.robots.recording.core.manifests import ENTRY_BYTES, FORM, first_head, next_head
from robotkube.robots.recording.core.one_time_signatures import holds


@dataclass(frozen=True)
class WriterManifest:
    """The manifest of one writer as the database has it. `heads`: the head behind each part, as far as the chain is
    whole; the first is that of no part."""

    life: int
    volume: str
    key: str
    parts: Sequence[Mapping[str, Any]]
    heads: Sequence[str]
    statement: Mapping[str, Any] | None
    text: str
    problem: str

    @property
    def sealed(self) -> bool:
        """Return whether its seal holds."""
        return self.statement is not None and not self.problem

    @property
    def before(self) -> Mapping[int, tuple[int, str]]:
        """The earlier writers' manifests that it went on behind: life -> parts and head."""
        before = self.statement["before"] if self.statement else {}
        return {int(life): (parts, head) for life, (parts, head) in before.items()}

    def row(self) -> dict[str, Any]:
        """The manifest as a table shows it."""
        adopted = sum(len(group["entries"]) for part in self.parts for group in part["groups"] if group["adopted"])
        entries = sum(len(group["entries"]) for part in self.parts for group in part["groups"])
        return {
            "writer": self.life,
            "volume": self.volume,
            "sealed": self.sealed,
            "documents": entries // ENTRY_BYTES,
            "adopted": adopted // ENTRY_BYTES,
            "key": self.key,
        }


def read_manifests(recording: str, documents: Iterable[Mapping[str, Any]]) -> list[WriterManifest]:
    """The manifests of a recording, oldest writer first."""
    begun: dict[int, Mapping[str, Any]] = {}
    parts: dict[int, list[Mapping[str, Any]]] = {}
    for document in documents:
        if "number" in document:
            parts.setdefault(int(document["life"]), []).append(document)
        else:
            begun[int(document["life"])] = document
    lives = sorted({*begun, *parts})
    return [_manifest(recording, life, begun.get(life), parts.get(life, [])) for life in lives]


def _manifest(
    recording: str, life: int, begun: Mapping[str, Any] | None, parts: Sequence[Mapping[str, Any]]
) -> WriterManifest:
    if begun is None:
        return WriterManifest(life, "", "", (), (), None, "", "its begin is not there")
    ordered = sorted(parts, key=lambda part: int(part["number"]))
    heads = [first_head(recording, life, begun["volume"], begun["key"])]
    for part in ordered:
        head = next_head(heads[-1], part["groups"])
        if part["number"] != len(heads) or part["previous"] != heads[-1] or part["head"] != head:
            break
        heads.append(head)
    whole = len(heads) == len(ordered) + 1
    problem = "" if whole else f"its part {len(heads)} is not there, or was changed"
    manifest = WriterManifest(
        life, begun["volume"], begun["key"], ordered[: len(heads) - 1], heads, None, begun["statement"] or "", problem
    )
    return sealed_by(recording, manifest, manifest.text, str(begun["signature"] or "")) if manifest.text else manifest


def sealed_by(recording: str, manifest: WriterManifest, text: str, signature: str) -> WriterManifest:
    """The manifest with a seal, or with the problem why that is none."""
    statement = read_statement(text)
    expected = {
        "form": FORM, "recording": recording, "life": manifest.life, "volume": manifest.volume, "key": manifest.key,
        "parts": len(manifest.parts), "head": manifest.heads[-1],
    }  # fmt: skip
    problem = manifest.problem or _wrong(statement, expected, text, signature, manifest.key)
    return replace(manifest, statement=statement, text=text, problem=problem)


def read_statement(text: str) -> Mapping[str, Any] | None:
    """The values of a line or a seal; None when it is none."""
    try:
        statement = json.loads(text)
    except ValueError:
        return None
    return statement if isinstance(statement, dict) else None


def _wrong(
    statement: Mapping[str, Any] | None, expected: Mapping[str, Any], text: str, signature: str, key: str
) -> str:
    try:
        signed = holds(text.encode(), bytes.fromhex(signature), bytes.fromhex(key))
    except ValueError:
        signed = False
    if not signed or statement is None:
        return "its seal is not by its key"
    differing = [name for name, value in expected.items() if statement.get(name) != value]
    return f"its seal says another {', '.join(differing)}" if differing else ""
