"""The audit of the deployment repository: each commit is traced to its cause, a merged pull request and all
trailers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scenarios.runner.inputs import Commit, PullRequestOfRun, RunInputs

PLAN_TRAILERS = ("Plan", "Trace", "Chart", "Evidence")
TASK_TRAILERS = ("Task", "Event", "Rule")
REPAIR = "repair"  # brings nothing that was not on main before
REPAIR_TRAILERS = ("Plan", "Trace", "Reverts")
PEOPLE_MAY_TOUCH = "policies/"


@dataclass(frozen=True)
class AuditEntry:
    """One commit with its pull request and what is missing, empty when it is complete."""

    commit: Commit
    pull_request: int | None
    missing: tuple[str, ...]

    def row(self) -> Mapping[str, object]:
        """The entry by the names of the report."""
        trailers = self.commit.trailers
        return {
            "task": " ".join(trailers.get("Task", ())) or None,
            "event": " ".join(trailers.get("Event", ())) or None,
            "pull_request": self.pull_request,
            "commit": self.commit.sha,
            "subject": self.commit.subject,
            "trailers": {f"RobotKube-{name}": list(values) for name, values in sorted(trailers.items())},
            "missing": list(self.missing),
        }


def entries(inputs: RunInputs) -> tuple[AuditEntry, ...]:
    """All commits of main but the seed, oldest first."""
    merged = {request.commit: request for request in inputs.pull_requests if request.merged and request.commit}
    commits = sorted((commit for commit in inputs.commits if commit.parents), key=lambda commit: commit.time)
    return tuple(entry(commit, merged.get(commit.sha)) for commit in commits)


def complete(inputs: RunInputs, entries: Sequence[AuditEntry]) -> bool | None:
    """Return whether nothing is missing in any commit and every merged plan is a commit of main; None when there is
    nothing."""
    if not entries:
        return None
    known = {commit.sha for commit in inputs.commits}
    plans = all(plan.commit in known for plan in inputs.plans if plan.merged)
    one_root = sum(not commit.parents for commit in inputs.commits) == 1
    return plans and one_root and not any(one.missing for one in entries)


def entry(commit: Commit, request: PullRequestOfRun | None) -> AuditEntry:
    """The entry of a commit and the pull request that was merged as it (None: none was)."""
    missing = [] if request else ["merged pull request"]
    if not _of_a_person(commit):
        missing += [f"RobotKube-{name}" for name in _missing_trailers(commit.trailers)]
    return AuditEntry(commit, request.number if request else None, tuple(missing))


def _of_a_person(commit: Commit) -> bool:
    """People change policies only, and their commits carry no plan; whatever touches releases is a plan's."""
    return bool(commit.paths) and all(path.startswith(PEOPLE_MAY_TOUCH) for path in commit.paths)


def _missing_trailers(trailers: Mapping[str, tuple[str, ...]]) -> list[str]:
    if REPAIR in trailers.get("Cause", ()):
        return [name for name in REPAIR_TRAILERS if not trailers.get(name)]
    missing = [name for name in PLAN_TRAILERS if not trailers.get(name)]
    if trailers.get("Cause") and not trailers.get("Task"):
        return missing  # initial configuration, update, lost node: nobody's task
    tasks = len(trailers.get("Task", ()))
    return missing + [name for name in TASK_TRAILERS if len(trailers.get(name, ())) != tasks or not tasks]
