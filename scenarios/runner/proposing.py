"""A person's change of the deployment repository: proposed as a pull request, merged when the gate agrees."""

from __future__ import annotations

from scenarios.runner.deployment import Deployment
from scenarios.runner.waiting import wait_for

MERGE_SECONDS_MAX = 60.0


def change(deployment: Deployment, path: str, text: str, subject: str, topic: str) -> int:
    """One changed file on main, by the account of `deployment`, under the branch name `topic`; the pull request's
    number. RunError with the forge's last words when it is not merged within the bound."""
    commit = deployment.propose(path, text, f"{subject}\n", topic)
    number = _opened(deployment, commit)
    refusals = ["not asked yet"]

    def merged() -> bool:
        if not deployment.pull_request(number).merged:
            refusals[0] = deployment.merge(number)
        return deployment.pull_request(number).merged

    wait_for(
        f"pull request #{number} on {path} to be merged",
        MERGE_SECONDS_MAX,
        merged,
        lambda: f"the forge's answer to merging it was: {refusals[0] or 'agreed'}",
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

    wait_for("the forge to open the pull request", MERGE_SECONDS_MAX, opened, lambda: f"commit {commit} was pushed")
    return numbers[0]
