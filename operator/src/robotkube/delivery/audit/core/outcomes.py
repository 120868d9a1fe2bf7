"""Outcomes of plans as the notes of their commits have them: where a release's pods ran, and on which images, as its
manager saw them once. Nobody signs them; what can be checked is that each speaks of its own commit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.audit.core.findings import Finding, short
from robotkube.delivery.audit.core.main_replay import MainChange
from robotkube.delivery.deployment.core.merge_records import OUTCOMES_REFERENCE
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.forge.core.histories import NoteHistory


@dataclass(frozen=True)
class Observed:
    """What a manager saw of one release, at the time `at` (ns since 1970, None where it is not known)."""

    nodes: tuple[str, ...]
    images: tuple[str, ...]
    at: int | None


@dataclass(frozen=True)
class Outcomes:
    """The outcomes of main's commits: commit -> key of a release -> what was seen of it."""

    by_commit: Mapping[str, Mapping[str, Observed]]
    findings: tuple[Finding, ...]


def read_outcomes(notes: NoteHistory, changes: Sequence[MainChange]) -> Outcomes:
    """The outcomes in the notes, checked against main's commits; what a changed note says is not believed."""
    known = {change.commit.id: change for change in changes}
    findings: list[Finding] = []
    for edit in notes.edits:
        word = "removed" if edit.removed else "changed"
        what = f"the note of {short(edit.annotated)} was {word} by {short(edit.by)} of {OUTCOMES_REFERENCE}"
        findings.append(_finding("note-edited", edit.annotated, what))
    edited = {edit.annotated for edit in notes.edits}
    by_commit: dict[str, Mapping[str, Observed]] = {}
    for annotated, text in sorted(notes.texts.items()):
        document = _document(text)
        problems = list(_problems(annotated, document, known.get(annotated)))
        findings += problems
        if document is not None and not problems and annotated not in edited:
            by_commit[annotated] = dict(_observed(document))
    return Outcomes(by_commit, tuple(findings))


def _document(text: str) -> Mapping[str, Any] | None:
    try:
        document = read_json(text)
    except ValueError:
        return None
    return document if isinstance(document, Mapping) else None


def _problems(annotated: str, document: Mapping[str, Any] | None, change: MainChange | None) -> Iterator[Finding]:
    if change is None:
        yield _finding("outcome-off-main", annotated, f"main has no commit {short(annotated)}")
    elif document is None or not isinstance(document.get("releases"), list):
        yield _finding("outcome-not-readable", annotated, "it is not the JSON of an outcome")
    elif document.get("commit") != annotated:
        yield _finding("outcome-of-other-commit", annotated, f"it speaks of commit {str(document.get('commit'))[:40]}")
    elif change.message is None or document.get("plan") != change.message.plan:
        plan = change.message.plan if change.message else "none that can be read"
        what = f"it speaks of plan {str(document.get('plan'))[:40]}, the commit's is {plan}"
        yield _finding("outcome-of-other-commit", annotated, what)


def _observed(document: Mapping[str, Any]) -> Iterator[tuple[str, Observed]]:
    at = document.get("observed")
    for item in document["releases"]:
        if isinstance(item, Mapping) and isinstance(item.get("release"), str):
            seen = Observed(_words(item.get("nodes")), _words(item.get("images")), at if isinstance(at, int) else None)
            yield item["release"], seen


def _words(value: Any) -> tuple[str, ...]:
    return tuple(map(str, value)) if isinstance(value, list) else ()


def _finding(kind: str, annotated: str, what: str) -> Finding:
    return Finding(kind, "deployment", f"outcome of {annotated}", what, annotated)
