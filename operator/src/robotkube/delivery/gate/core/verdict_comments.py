"""The gate's comments on pull requests (Markdown). The manager reads their first words, which are fixed here."""

from __future__ import annotations

from collections.abc import Sequence

from robotkube.delivery.deployment.core.policies.merge import APPROVAL, PATH, Way
from robotkube.delivery.deployment.core.verdict_words import STALE, WAITS
from robotkube.delivery.gate.core.proposal_checks import ProposalVerdict, ProposedCommit
from robotkube.foundation.forge.core import merge_comments


def refusal_text(commit: str, problems: Sequence[str]) -> str:
    """The comment that explains to the author of a proposal why it was refused."""
    return "\n".join(
        [f"Refused {commit[:12]}: the gate does not merge this commit.", "", *merge_comments.listed(problems), ""]
    )


def stale_text(parent: str, tip: str) -> str:
    """The comment that asks the author of a proposal to build it again."""
    where = f"this commit was built on {parent[:12]}, main is at {tip[:12]}"
    return f"Closed, {STALE}: {where}. Build it again on main's tip.\n"


def waiting_text(commit: str, way: Way) -> str:
    """The comment on a manager's proposal that passes the checks, but that policies/merge.yaml does not let merge by
    itself."""
    return f"{WAITS}: {commit[:12]} passes the checks. {_next_step(way)}\n"


def checked_text(commit: str, proposal: ProposedCommit, verdict: ProposalVerdict, way: Way) -> str:
    """The comment on a person's pull request; the same first line for the same commit and verdict."""
    if verdict.problems:
        return merge_comments.refused_text(commit, verdict.problems)
    if verdict.stale:
        return merge_comments.outdated_text(commit, proposal.overlaps)
    return merge_comments.accepted_text(commit, _next_step(way))


def _next_step(way: Way) -> str:
    if way == APPROVAL:
        who = "when another person with write rights approves it"
        return f"{PATH}: the gate merges what exactly this commit changes {who}."
    return f"{PATH} names no way to main for these files: name them under `person` there, in a pull request of its own."
