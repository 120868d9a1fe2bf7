"""A person's change of the deployment repository: proposed as a pull request, approved by another person, merged by the
gate."""

from __future__ import annotations

from scenarios.runner.platform.deployment import Deployment
from scenarios.runner.waiting import wait_for

MERGE_SECONDS_MAX = 60.0


def change(deployment: Deployment, path: str, text: str, subject: str, topic: str) -> int:
    """One changed file on main, by the account of `deployment`, under the branch name `topic`; the pull request's
    number. RunError with the gate's words when it is not merged within the bound."""
    commit = deployment.propose(path, text, f"{subject}\n", topic)
    number = _opened(deployment, commit)
    deployment.approve(number, commit)
    wait_for(
        f"pull request #{number} on {path} to be merged",
        MERGE_SECONDS_MAX,
        lambda: deployment.pull_request(number).merged,
        lambda: f"the gate has said: {deployment.comments(number) or 'nothing'}",
        poll_seconds=1.0,
    )
    return number


def _opened(deployment: Deployment, commit: str) -> int:
    """The number of the pull request that the forge opened for a pushed commit."""
    numbers: list[int] = []

    def opened() -> bool:
        number = deployment.number_of(commit)
        numbers.extend([number] if number else [])
        return bool(numbers)

    wait_for(
        "the forge to open the pull request",
        MERGE_SECONDS_MAX,
        opened,
        lambda: f"commit {commit} was pushed",
    )
    return numbers[0]
