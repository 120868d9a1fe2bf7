"""Merging of a person's pull request: a commit of the gate's own that joins main and exactly what was approved.

Its first parent is main's tip, its second the approved commit, and it changes what that commit changed since it left
main, nothing else. So a branch may have several commits and may be behind main, as long as main did not change the same
files; every commit on main's first-parent line is a state that was checked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from robotkube.foundation.forge.core.trailers import APPROVED_BY, PULL_REQUEST, trailer
from robotkube.foundation.forge.ports.pull_requests import PullRequest
from robotkube.foundation.forge.ports.repositories import Commit, Commits, MainBranch

SUBJECT_CHARACTERS_MAX = 200


def merge_commit(
    main: MainBranch,
    commits: Commits,
    pull: PullRequest,
    change: Commit,
    approvers: Sequence[str],
    own: Mapping[str, str | None] | None = None,
) -> Commit:
    """The merge of `change` (as `changes_since_branch` gives it) into main's tip, read back from Git as it would be
    pushed: its changes are those to main. `own` are files that the gate adds."""
    message = merge_message(pull.number, change.message, approvers)
    changes = {**change.changes, **(own or {})}
    return main.changes_since_branch(commits.commit(main.tip, changes, message, change.id, pull.author))


def merge_message(number: int, message: str, approvers: Sequence[str]) -> str:
    """The first line of the approved commit's message with the pull request's number, and who approved it. Nothing else
    of the author's words: a trailer of theirs would be the gate's word here."""
    subject = " ".join(message.partition("\n")[0].split())[:SUBJECT_CHARACTERS_MAX] or "Merge a pull request"
    trailers = [trailer(PULL_REQUEST, number), *(trailer(APPROVED_BY, account) for account in approvers)]
    return "\n".join([f"{subject} (#{number})", "", *trailers, ""])
