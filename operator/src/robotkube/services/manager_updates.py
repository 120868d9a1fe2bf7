"""What updates did to main and how their releases fare: read from commits, Argo CD Applications and nodes.

Nothing stands only here: a new process reads the same from main's history and from the cluster.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

from robotkube.domain.catalogue import Catalogue
from robotkube.domain.composition import Desired
from robotkube.domain.errors import DocumentError
from robotkube.domain.observation import ApplicationState, judge_present
from robotkube.domain.placement import Fleet
from robotkube.domain.planning import Change
from robotkube.domain.proposals import REVERT, UPDATE
from robotkube.domain.releases import PLAN, RELEASES, Release, application_name, read_release
from robotkube.domain.update_policies import PATH, UpdatePolicy, read_update_policy
from robotkube.domain.updates import (
    DEGRADED,
    HEALTHY,
    PROGRESSING,
    Health,
    Move,
    Pin,
    Sight,
    Targets,
    UpdateMemory,
    Updates,
    decide,
    moved,
    plan_ns,
)
from robotkube.ports.clusters import Cluster
from robotkube.ports.git import Commit, DeploymentRepository
from robotkube.services.assured_catalogue import AssuredCatalogue

COMMITS_MAX = 10_000
WORDS = (f"RobotKube-Cause: {UPDATE}\n", f"RobotKube-Cause: {REVERT}\n")
PLAN_TRAILER = re.compile(rf"^RobotKube-Plan: ({PLAN.pattern})$", re.MULTILINE)
REVERTS_TRAILER = re.compile(r"^RobotKube-Reverts: ([0-9a-f]{40})$", re.MULTILINE)
PASSED_MAX = 5
NO_POLICY = UpdatePolicy()
UNREADABLE = f"{PATH} cannot be read; nothing is updated"

_Inputs = tuple[Mapping[str, Release], Targets, UpdatePolicy, UpdateMemory, frozenset[str]]
"""What `decide` decides about, apart from time and cluster."""

log = logging.getLogger(__name__)


class UpdateHistory:
    """Updates, reverts and changes of their policy among main's newest COMMITS_MAX commits."""

    def __init__(self, repository: DeploymentRepository) -> None:
        self._repository = repository
        self._tip = ""
        self._memory = UpdateMemory()

    def read(self, tip: str) -> UpdateMemory:
        """The memory at main's tip, which was fetched."""
        if tip != self._tip:
            for commit in self._repository.touching(self._tip or None, COMMITS_MAX, PATH, WORDS):
                self._memory = self._after(commit)
            self._tip = tip
        return self._memory

    def _after(self, commit: Commit) -> UpdateMemory:
        memory = self._memory.policy_changed() if PATH in commit.changes else self._memory
        changed = _releases(commit.changes)
        subject = commit.message.partition("\n")[0]
        undone = self._undone(memory, commit)
        if undone:
            for chart in undone:
                keys = [release.key for release in changed if release.chart == chart]
                memory = memory.reverted(chart, keys, f"{subject} ({commit.id[:12]}); change {PATH} to try it again")
        elif WORDS[0] in commit.message:
            before = self._before(commit, changed)
            for target in {(release.chart, release.version, release.digest) for release in changed}:
                moved = [r for r in changed if (r.chart, r.version, r.digest) == target and r.key in before]
                pins = {r.key: before[r.key] for r in moved if before[r.key][0] == r.chart}
                memory = memory.updated(target[0], target[1:], pins, (commit.id, commit_ns(commit.message)))
        return memory

    @staticmethod
    def _undone(memory: UpdateMemory, commit: Commit) -> list[str]:
        """Charts whose last update the commit takes back; a revert of people's edits takes back none."""
        named = set(REVERTS_TRAILER.findall(commit.message))
        return [chart for chart, run in memory.runs.items() if named & set(run.commits)]

    def _before(self, commit: Commit, changed: Sequence[Release]) -> Mapping[str, tuple[str, str]]:
        """Chart and version that the changed releases had in the commit's parent."""
        if not commit.parents:
            return {}
        folders = sorted({f"{RELEASES}/{release.namespace}" for release in changed})
        found = _releases(self._repository.files(commit.parents[0], folders))
        return {release.key: (release.chart, release.version) for release in found}


class PolicyReader:
    """policies/updates.yaml of main; the last good one stays while a newer one is broken."""

    def __init__(self, repository: DeploymentRepository) -> None:
        self._repository = repository
        self._tip = ""
        self._policy: UpdatePolicy | None = None

    def read(self, tip: str) -> UpdatePolicy | None:
        """The policy at main's tip, which was fetched; None while there never was a good one."""
        if tip != self._tip:
            text = self._repository.files(tip, (PATH.partition("/")[0],)).get(PATH, "{}\n")
            try:
                self._policy = read_update_policy(text)
            except DocumentError as error:
                log.error("policy not taken commit=%s problem=%r", tip[:12], str(error))
            self._tip = tip
        return self._policy


class Updating:
    """Which versions the releases keep at one look, and the plan of the one update or revert that may be made."""

    def __init__(self, repository: DeploymentRepository, cluster: Cluster) -> None:
        self._history, self._policy, self._cluster = UpdateHistory(repository), PolicyReader(repository), cluster
        self._unfit: tuple[str, frozenset[str]] = ("", frozenset())
        self._said: frozenset[str] = frozenset()
        self._targets = Targets(Catalogue())
        self._passed = 0
        self._steady: tuple[_Inputs, Updates] | None = None
        self.updates = Updates()

    def look(
        self,
        present: Mapping[str, Release],
        tip: str,
        catalogue: AssuredCatalogue,
        machines: Fleet,
        held: Collection[str],
        now_ns: int,
    ) -> Updates:
        """Decide about main's releases (`present`, by path) at its `tip`; the words are logged when they are new.
        Agents that hold changes (`held`) count like those that are offline."""
        tips = f"{tip} {catalogue.tip}"
        self._unfit = self._unfit if self._unfit[0] == tips else (tips, frozenset())
        policy, memory = self._policy.read(tip), self._history.read(tip)
        if self._targets.catalogue is not catalogue.catalogue:
            self._targets = Targets(catalogue.catalogue)

        def sight() -> Sight:
            return sight_of(present, self._cluster.applications(), machines, held)

        inputs = present, self._targets, policy or NO_POLICY, memory, self._unfit[1]
        found = self._decided(inputs, sight, now_ns)
        self.updates = found if policy else replace(found, move=None, words=(UNREADABLE,))
        for text in sorted(frozenset(self.updates.words) - self._said):
            log.info("update text=%r", text)
        self._said = frozenset(self.updates.words)
        return self.updates

    def _decided(self, inputs: _Inputs, sight: Callable[[], Sight], now_ns: int) -> Updates:
        """As `decide`. When nothing is under way, which it says by not asking for `sight`, neither time nor cluster
        count: the answer is the same for the same objects."""
        if self._steady and all(mine is now for mine, now in zip(self._steady[0], inputs, strict=True)):
            return self._steady[1]
        asked: list[Sight] = []

        def look() -> Sight:
            asked.append(sight())
            return asked[0]

        present, targets, policy, memory, unfit = inputs
        found = decide(present, targets, policy, memory, look, now_ns, unfit)
        self._steady = None if asked else (inputs, found)
        return found

    def step(
        self,
        steady: Desired,
        present: Mapping[str, Release],
        others_wait: bool,
        compose: Callable[[Mapping[str, Pin]], Desired],
    ) -> tuple[Move, tuple[Change, ...]] | None:
        """The move that was decided and its changes, tried by composing with its pins. None when there is none, when it
        does not fit (which is said, and not tried again before main or catalogue change), and while changes that tasks
        ask for wait: these come before an update, though not more than PASSED_MAX times; a revert waits for nobody."""
        move = self.updates.move
        if move is None:
            return None
        if others_wait and move.cause == UPDATE and self._passed < PASSED_MAX:
            self._passed += 1
            return None
        self._passed = 0
        changes, problem = moved(move, compose(move.pins), steady, present)
        if not changes:
            log.warning("update not made text=%r", problem)
            self._unfit = (self._unfit[0], self._unfit[1] | frozenset(move.keys))
            return None
        return move, changes


def _releases(files: Mapping[str, str | None]) -> list[Release]:
    """Readable release files."""
    found = []
    for path, text in files.items():
        if text is not None and path.startswith(f"{RELEASES}/") and path.endswith(".yaml"):
            try:
                found.append(read_release(text, path))
            except DocumentError as error:
                log.warning("release of an update not read path=%s reason=%s", path, error)
    return found


def commit_ns(message: str) -> int:
    """When the plan of a commit was made, by its id (ns since 1970); 0 when the message names none."""
    match = PLAN_TRAILER.search(message)
    return plan_ns(match[1]) if match else 0


def sight_of(
    present: Mapping[str, Release],
    applications: Mapping[str, ApplicationState],
    fleet: Fleet,
    held: Collection[str] = (),
) -> Sight:
    """How main's releases fare, and which agents' namespaces can be reached and are not `held`."""
    health = {}
    for release in present.values():
        found = applications.get(application_name(release.namespace, release.name))
        health[release.key] = _health(found, release)
    online = {}
    for name, agent in fleet.agents.items():
        ready = [node.ready_since or 0 for node in fleet.nodes.get(name, ()) if node.ready]
        if ready and name not in held:
            online[agent.namespace] = min(ready)
    return Sight(health, online)


def _health(application: ApplicationState | None, release: Release) -> Health:
    verdict = judge_present(application, release.plan)
    if application is None or not verdict.synced:
        return Health(PROGRESSING)
    if verdict.done:
        return Health(HEALTHY, application.health_since)
    return Health(DEGRADED if application.health == "Degraded" else PROGRESSING, application.health_since)
