"""What became of commits that the gate did not check: undone by a plan, accepted by people, or replaced."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from robotkube.delivery.audit.core.findings import Finding
from robotkube.delivery.audit.core.main_replay import MainChange
from robotkube.delivery.deployment.core.break_glass import ACCEPTED_PATH, read_accepted
from robotkube.errors import DocumentError

UNDONE, ACCEPTED, REPLACED = "undone", "accepted", "replaced"
REPORTED = ("break-glass", "break-glass-not-signed", "changed-by-hand")
"""The findings that say what became of their commit."""


@dataclass(frozen=True)
class MadeGood:
    """How it ended (UNDONE, ACCEPTED, REPLACED), and the checked commit that did it."""

    how: str
    commit: str


def made_good(changes: Sequence[MainChange], checked: Collection[str]) -> Mapping[str, MadeGood]:
    """Commit -> what became of it, for those of main that are not among the `checked` ones; what still stands is left
    out. Only checked commits make good."""
    ends: dict[str, MadeGood] = {}
    standing: dict[str, set[str]] = {}  # commit -> paths that nothing has replaced since
    for change in changes:
        commit = change.commit
        if commit.id not in checked:
            if commit.parents:
                standing[commit.id] = set(commit.paths)
            continue
        for undone in change.message.reverts if change.message else ():
            ends[undone] = MadeGood(UNDONE, commit.id)
        if ACCEPTED_PATH in commit.changes:
            ends = dict(_with_accepted(ends, commit.changes[ACCEPTED_PATH] or "", commit.id))
        for other, paths in standing.items():
            if paths and not paths - set(commit.paths):
                ends.setdefault(other, MadeGood(REPLACED, commit.id))
            paths -= set(commit.paths)
    return {commit: end for commit, end in ends.items() if commit in standing}


def _with_accepted(ends: Mapping[str, MadeGood], text: str, commit: str) -> Iterator[tuple[str, MadeGood]]:
    """The ends after policies/accepted-commits was written anew: who is taken off the list is accepted no more."""
    try:
        accepted = read_accepted(text)
    except DocumentError:
        yield from ends.items()
        return
    for other, end in ends.items():
        if end.how != ACCEPTED or other in accepted:
            yield other, end
    for other in accepted - ends.keys():
        yield other, MadeGood(ACCEPTED, commit)


def with_ends(findings: Iterable[Finding], ends: Mapping[str, MadeGood]) -> Iterator[Finding]:
    """The findings; those about commits that were made good say so."""
    for finding in findings:
        end = ends.get(finding.commit) if finding.kind in REPORTED else None
        yield replace(finding, what=f"{finding.what}; {end.how} by commit {end.commit}") if end else finding
