"""A decision about one task in words: what becomes of it, why, and what it changes in the deployment repository."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from robotkube.delivery.deployment.core.releases import Tree, write_release, write_source
from robotkube.delivery.manager.core.composition.inputs import Met
from robotkube.delivery.manager.core.conflicts import DemandOutcome, Postponed
from robotkube.delivery.manager.core.plans import Change, Plan
from robotkube.delivery.tasks.core.task_description import HELD_BY_AGENT


@dataclass(frozen=True)
class FileChange:
    """A changed file of the deployment repository: its text before and after; None where it is not there."""

    path: str
    before: str | None
    after: str | None


@dataclass(frozen=True)
class Explanation:
    """The decision about a task: its outcome (None: it is withdrawn), every choice in words (one line each), and the
    files that change.
    `waits`: for which agents its changes would wait, and until when; empty when they would be made at once."""

    key: str
    outcome: DemandOutcome | None
    lines: tuple[str, ...]
    changes: tuple[FileChange, ...] = ()
    waits: str = ""


def explain(
    key: str,
    outcome: DemandOutcome,
    others: Mapping[str, tuple[DemandOutcome | None, DemandOutcome]],
    plan: Plan | None,
    tree: Tree,
    waits: str = "",
) -> Explanation:
    """The explanation of one outcome. `others` are demands that fare otherwise with this task: their outcomes without
    and with it; `plan` is what this task changes on main, which `tree` is (None: nothing); `waits`: see Explanation."""
    lines = [f"{key} {_verdict(outcome)}"]
    lines += [f"{key} waits, {HELD_BY_AGENT}: {waits}"] if waits else ()
    lines += outcome.choices if isinstance(outcome, Met) else ()
    lines += [
        f"{other} {_verdict(after)}; without this task it {_verdict(before)}"
        for other, (before, after) in sorted(others.items())
    ]
    lines += _changed(plan.changes if plan else ())
    return Explanation(key, outcome, tuple(lines), _file_changes(plan, tree), waits)


def explain_withdrawal(
    key: str,
    others: Mapping[str, tuple[DemandOutcome | None, DemandOutcome]],
    plan: Plan | None,
    tree: Tree,
    waits: str = "",
) -> Explanation:
    """The explanation of a withdrawal. `others` are demands that fare otherwise without this task: their outcomes with
    and without it; `plan` is what that changes on main; the rest as in `explain`."""
    lines = [f"{key} would be withdrawn"]
    lines += [f"that waits, {HELD_BY_AGENT}: {waits}"] if waits else ()
    lines += [
        f"{other} {_verdict(after)}; with this task it {_verdict(before)}"
        for other, (before, after) in sorted(others.items())
    ]
    lines += _changed(plan.changes if plan else ())
    return Explanation(key, None, tuple(lines), _file_changes(plan, tree), waits)


def _file_changes(plan: Plan | None, tree: Tree) -> tuple[FileChange, ...]:
    files = plan.files if plan else {}
    return tuple(FileChange(path, _text(path, tree), files[path]) for path in sorted(files))


def _verdict(outcome: DemandOutcome | None) -> str:
    if outcome is None:
        return "is not decided yet"
    if isinstance(outcome, Met):
        return f"is accepted; its releases: {', '.join(outcome.releases) or 'none'}"
    if isinstance(outcome, Postponed):
        return f"is postponed: {outcome.message}"
    return f"is refused, {outcome.reason}: {outcome.message}"


def _changed(changes: Iterable[Change]) -> list[str]:
    verbs = {"add": "starts", "change": "changes", "remove": "stops"}
    lines = [f"{verbs[c.kind]} {c.release.key} ({c.release.chart} {c.release.version})" for c in changes]
    return lines or ["changes nothing in the deployment repository"]


def _text(path: str, tree: Tree) -> str | None:
    if path in tree.releases:
        return write_release(tree.releases[path])
    return write_source(tree.sources[path]) if path in tree.sources else None
