"""The gate's comments on people's pull requests (Markdown), of whatever repository; the first line says all in one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

PROBLEMS_SHOWN_MAX = 50
NOBODY = "Main moves by the gate alone, so nobody can merge it: push a corrected commit, or close it."
UPDATE = "Merge main into your branch, or rebase it; then have the new commit approved."


def accepted_text(commit: str, next_step: str) -> str:
    """The comment on a commit that the checks let pass."""
    return f"Checked {commit[:12]}: nothing speaks against it.\n\n{next_step}\n"


def refused_text(commit: str, problems: Sequence[str]) -> str:
    """The comment on a commit that is not merged, whoever approves it."""
    return "\n".join([f"Checked {commit[:12]}: it cannot be merged.", "", *listed(problems), "", NOBODY, ""])


def outdated_text(commit: str, overlaps: Iterable[str]) -> str:
    """The comment on a commit that changed the same files as main did since."""
    files = listed([f"{path}: main has changed this file as well" for path in overlaps])
    first = f"Checked {commit[:12]}: it cannot be merged before its branch is updated."
    return "\n".join([first, "", *files, "", UPDATE, ""])


def listed(problems: Sequence[str]) -> list[str]:
    """The problems as a list, one line each, and how many more there are."""
    shown = [f"- {' '.join(problem.split())}" for problem in problems[:PROBLEMS_SHOWN_MAX]]
    rest = len(problems) - len(shown)
    return [*shown, f"- and {rest} more"] if rest > 0 else shown
