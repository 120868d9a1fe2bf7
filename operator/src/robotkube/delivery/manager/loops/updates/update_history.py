"""The history of updates in main's commits."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

from robotkube.delivery.deployment.core.commit_messages import REVERT, UPDATE
from robotkube.delivery.deployment.core.policies.updates import PATH
from robotkube.delivery.deployment.core.releases import RELEASES, Release, read_release
from robotkube.delivery.manager.core.updates.memory import UpdateMemory
from robotkube.delivery.manager.core.updates.verdicts import plan_ns
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import COMMIT, PLAN
from robotkube.foundation.forge.core.trailers import read_trailers, trailer
from robotkube.foundation.forge.ports.repositories import Commit, DeploymentRepository

COMMITS_MAX = 10_000
CAUSES = tuple(f"{trailer('Cause', kind)}\n" for kind in (UPDATE, REVERT))

log = logging.getLogger(__name__)


class UpdateHistory:
    """The history of updates, reverts and changes of their policy among main's newest COMMITS_MAX commits."""

    def __init__(self, repository: DeploymentRepository) -> None:
        self._repository = repository
        self._tip = ""
        self._memory = UpdateMemory()

    def read(self, tip: str) -> UpdateMemory:
        """The memory at main's tip, which was fetched."""
        if tip != self._tip:
            for commit in self._repository.touching(self._tip or None, COMMITS_MAX, PATH, CAUSES):
                self._memory = self._after(commit)
            self._tip = tip
        return self._memory

    def _after(self, commit: Commit) -> UpdateMemory:
        memory = self._memory.policy_changed() if PATH in commit.changes else self._memory
        changed = _releases(commit.changes)
        subject = commit.message.partition("\n")[0]
        kinds = read_trailers(commit.message).get("Cause", ())
        undone = self._undone(memory, commit)
        if undone:
            for chart in undone:
                keys = [release.key for release in changed if release.chart == chart]
                memory = memory.reverted(chart, keys, f"{subject} ({commit.id[:12]}); change {PATH} to try it again")
        elif REVERT in kinds and not _reverted(commit.message):
            memory = self._taken_back(memory, changed, f"{subject} ({commit.id[:12]}); change {PATH} to try it again")
        elif UPDATE in kinds:
            before = self._before(commit, changed)
            for target in {(release.chart, release.version, release.digest) for release in changed}:
                moved = [r for r in changed if (r.chart, r.version, r.digest) == target and r.key in before]
                pins = {r.key: before[r.key] for r in moved if before[r.key][0] == r.chart}
                memory = memory.updated(target[0], target[1:], pins, (commit.id, commit_ns(commit.message)))
        return memory

    @staticmethod
    def _taken_back(memory: UpdateMemory, changed: Sequence[Release], why: str) -> UpdateMemory:
        """The memory after a commit that undoes no whole commit, but an update for some agents."""
        for chart, run in memory.runs.items():
            keys = [r.key for r in changed if r.chart == chart and run.before.get(r.key) == (chart, r.version)]
            memory = memory.taken_back(chart, keys, why)
        return memory

    @staticmethod
    def _undone(memory: UpdateMemory, commit: Commit) -> list[str]:
        """The charts whose last update the commit reverts; a revert of people's edits reverts none."""
        named = _reverted(commit.message)
        return [chart for chart, run in memory.runs.items() if named & set(run.commits)]

    def _before(self, commit: Commit, changed: Sequence[Release]) -> Mapping[str, tuple[str, str]]:
        """The chart and the version that the changed releases had in the commit's parent."""
        if not commit.parents:
            return {}
        folders = sorted({f"{RELEASES}/{release.namespace}" for release in changed})
        releases = _releases(self._repository.files(commit.parents[0], folders))
        return {release.key: (release.chart, release.version) for release in releases}


def _releases(files: Mapping[str, str | None]) -> list[Release]:
    """The releases in readable release files."""
    releases = []
    for path, text in files.items():
        if text is not None and path.startswith(f"{RELEASES}/") and path.endswith(".yaml"):
            try:
                releases.append(read_release(text, path))
            except DocumentError as error:
                log.warning("release of an update not read path=%s reason=%s", path, error)
    return releases


def _reverted(message: str) -> set[str]:
    """The commits that a commit says it undoes."""
    return {word for word in read_trailers(message).get("Reverts", ()) if COMMIT.fullmatch(word)}


def commit_ns(message: str) -> int:
    """The time at which the plan of a commit was made, by its id (ns since 1970); 0 when the message names none."""
    plans = (word for word in read_trailers(message).get("Plan", ()) if PLAN.fullmatch(word))
    return next(map(plan_ns, plans), 0)
