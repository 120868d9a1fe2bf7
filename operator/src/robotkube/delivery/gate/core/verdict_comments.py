"""The gate's comments on pull requests (Markdown). The manager reads their first words, which are fixed here."""

from __future__ import annotations

from collections.abc import Sequence

from robotkube.delivery.deployment.core.policies.merge import APPROVAL, AUTOMATIC, PATH, Way
from robotkube.delivery.deployment.core.verdict_words import STALE, WAITS
from robotkube.delivery.gate.core.proposal_checks import ProposalVerdict

PROBLEMS_SHOWN_MAX = 50


def refusal_text(commit: str, problems: Sequence[str]) -> str:
    """The comment that explains to the author of a proposal why it was refused."""
    return "\n".join([f"Refused {commit[:12]}: the gate does not merge this commit.", "", *_listed(problems), ""])


def stale_text(parent: str, tip: str) -> str:
    """The comment that asks the author of a proposal to build it again."""
    where = f"this commit was built on {parent[:12]}, main is at {tip[:12]}"
    return f"Closed, {STALE}: {where}. Build it again on main's tip.\n"


def waiting_text(commit: str, way: Way) -> str:
    """The comment on a manager's proposal that passes the checks, but that policies/merge.yaml does not let merge by
    itself."""
    return f"{WAITS}: {commit[:12]} passes the checks. {_next_step(way)}\n"


def checked_text(commit: str, verdict: ProposalVerdict, way: Way) -> str:
    """The comment on a person's pull request; the same first line for the same commit."""
    first = f"Checked {commit[:12]}: "
    if verdict.problems:
        return "\n".join([f"{first}the gate would not merge this.", "", *_listed(verdict.problems), ""])
    if verdict.stale and way != AUTOMATIC:
        rest = "It is not built on main's tip: the gate can merge it only after an update of the branch (by rebase)."
        return f"{first}nothing speaks against it.\n\n{_next_step(way)} {rest}\n"
    if verdict.stale:
        return f"{first}nothing speaks against it.\n\nIt is not built on main's tip: update the branch (by rebase).\n"
    return f"{first}nothing speaks against it.\n\n{_next_step(way)}\n"


def unmergeable_text(commit: str, verdict: ProposalVerdict) -> str:
    """The comment on a person's pull request that is approved and still cannot be merged by the gate."""
    first = f"Approved {commit[:12]}, but the gate cannot merge it"
    if verdict.problems:
        return "\n".join([f"{first}.", "", *_listed(verdict.problems), ""])
    return f"{first}: {STALE}. Update the branch (by rebase) and approve it again.\n"


def _next_step(way: Way) -> str:
    if way == AUTOMATIC:
        return "The gate merges it now."
    if way == APPROVAL:
        return f"{PATH}: the gate merges exactly this commit when another person with write rights approves it."
    return f"{PATH} does not let the gate merge it: people do that in the forge."


def _listed(problems: Sequence[str]) -> list[str]:
    shown = [f"- {' '.join(problem.split())}" for problem in problems[:PROBLEMS_SHOWN_MAX]]
    rest = len(problems) - len(shown)
    return [*shown, f"- and {rest} more"] if rest > 0 else shown
