"""The outcome of a plan as a comment on its pull request, and the same facts as the note of its commit.

The comment is for people, with the facts as JSON in it; the note is that JSON. Only the fixed form is read back.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from robotkube.foundation.documents.core.json_codec import read_json

FIRST_WORD = "Observed "
NOTE_CHARACTERS_MAX = 32 * 1024
RELEASES_SHOWN_MAX = 50
_OPEN = "```json\n"
_CLOSE = "\n```"


@dataclass(frozen=True)
class ReleaseOutcome:
    """The outcome of one release: Argo CD's sync and health, the nodes of its pods, the digests of their images."""

    release: str
    sync: str
    health: str
    nodes: tuple[str, ...]
    images: tuple[str, ...]


@dataclass(frozen=True)
class PlanOutcome:
    """The outcome of one plan in the cluster; times are ns since 1970, None where they are not known."""

    plan: str
    commit: str
    merged: int | None
    synced: int | None
    observed: int | None
    releases: tuple[ReleaseOutcome, ...]
    removed: tuple[str, ...]
    note: str = ""


def outcome_comment(facts: PlanOutcome) -> str:
    """The comment with a plan's outcome (Markdown)."""
    lines = [f"{FIRST_WORD}plan `{facts.plan}`, commit {facts.commit[:12]}.", ""]
    for release in facts.releases[:RELEASES_SHOWN_MAX]:
        where = f" on {', '.join(release.nodes)}" if release.nodes else ""
        lines.append(f"- `{release.release}`: {release.sync or 'unknown'}, {release.health or 'unknown'}{where}")
    lines += [f"- `{key}`: removed" for key in facts.removed[:RELEASES_SHOWN_MAX]]
    lines += [f"- {' '.join(facts.note.split())}"] if facts.note else []
    return "\n".join([*lines, "", f"{_OPEN}{note_text(facts)}{_CLOSE}", ""])


def note_text(facts: PlanOutcome) -> str:
    """The note with a plan's outcome: one line of JSON, keys sorted; releases are left out from the end when it would
    be too long."""
    document = asdict(facts)
    text = json.dumps(document, sort_keys=True)
    while len(text) > NOTE_CHARACTERS_MAX and document["releases"]:
        document["releases"] = document["releases"][: len(document["releases"]) // 2]
        text = json.dumps({**document, "shortened": True}, sort_keys=True)
    return text


def read_note(comment: str, commit: str) -> str | None:
    """The note in a comment about `commit`; None when the comment has no outcome of exactly that."""
    if not comment.startswith(FIRST_WORD):
        return None
    note = comment.partition(_OPEN)[2].partition(_CLOSE)[0]
    try:
        document: Any = read_json(note)
    except ValueError:
        return None
    if not isinstance(document, Mapping) or document.get("commit") != commit or len(note) > NOTE_CHARACTERS_MAX:
        return None
    return json.dumps(document, sort_keys=True)
