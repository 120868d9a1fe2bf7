"""A decision about one task in words: what becomes of it, why, and what it changes in the deployment repository."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from robotkube.domain.conflicts import Outcome, Postponed
from robotkube.domain.planning import Change, Plan
from robotkube.domain.releases import Tree, write_release, write_source
from robotkube.domain.tasks import HELD_BY_AGENT
from robotkube.domain.worlds import Met


@dataclass(frozen=True)
class FileChange:
    """A file of the deployment repository: its text before and after; None where it is not there."""

    path: str
    before: str | None
    after: str | None


@dataclass(frozen=True)
class Explanation:
    """What would become of a task: its outcome, every choice in words (one line each), and the files that change.
    `waits`: for which agents its changes would wait, and until when; empty when they would be made at once."""

    key: str
    outcome: Outcome
    lines: tuple[str, ...]
    changes: tuple[FileChange, ...] = ()
    waits: str = ""


def explain(
    key: str,
    outcome: Outcome,
    others: Mapping[str, tuple[Outcome | None, Outcome]],
    plan: Plan | None,
    tree: Tree,
    waits: str = "",
) -> Explanation:
    """`others` are demands that fare otherwise with this task: what becomes of them without and with it; `plan` is what
    this task changes on main, which `tree` is (None: nothing); `waits`: see Explanation."""
    lines = [f"{key} {_verdict(outcome)}"]
    lines += [f"{key} waits, {HELD_BY_AGENT}: {waits}"] if waits else ()
    lines += outcome.choices if isinstance(outcome, Met) else ()
    lines += [
        f"{other} {_verdict(after)}; without this task it {_verdict(before)}"
        for other, (before, after) in sorted(others.items())
    ]
    lines += _changed(plan.changes if plan else ())
    files = plan.files if plan else {}
    changes = tuple(FileChange(p, _text(p, tree), files[p]) for p in sorted(files))
    return Explanation(key, outcome, tuple(lines), changes, waits)


def _verdict(outcome: Outcome | None) -> str:
    if outcome is None:
        return "is not looked at yet"
    if isinstance(outcome, Met):
        return f"is accepted; its releases: {', '.join(outcome.releases) or 'none'}"
    if isinstance(outcome, Postponed):
        return f"is postponed: {outcome.message}"
    return f"is refused, {outcome.reason}: {outcome.message}"


def _changed(changes: Iterable[Change]) -> list[str]:
    words = {"add": "starts", "change": "changes", "remove": "stops"}
    found = [f"{words[c.kind]} {c.release.key} ({c.release.chart} {c.release.version})" for c in changes]
    return found or ["changes nothing in the deployment repository"]


def _text(path: str, tree: Tree) -> str | None:
    if path in tree.releases:
        return write_release(tree.releases[path])
    return write_source(tree.sources[path]) if path in tree.sources else None
