"""The course of updates: what they did to main, and the health of their releases in the cluster.

Nothing is kept only here: a new process reads the same from main's history and from the cluster.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace

from robotkube.delivery.deployment.core.commit_messages import UPDATE
from robotkube.delivery.deployment.core.policies.updates import PATH, UpdatePolicy, read_update_policy
from robotkube.delivery.deployment.core.releases import Release, application_name
from robotkube.delivery.manager.core.composition.composer import Composition
from robotkube.delivery.manager.core.observation import ApplicationState, judge_present
from robotkube.delivery.manager.core.placement.placement import Fleet
from robotkube.delivery.manager.core.plans import Change
from robotkube.delivery.manager.core.updates.cluster_health import (
    DEGRADED,
    HEALTHY,
    PROGRESSING,
    ClusterHealth,
    ReleaseHealth,
)
from robotkube.delivery.manager.core.updates.memory import Pin, UpdateMemory
from robotkube.delivery.manager.core.updates.probe_answers import ProbeAnswers, probe_answers
from robotkube.delivery.manager.core.updates.rule_events import events_by_namespace, watchers_of
from robotkube.delivery.manager.core.updates.steps import Move, Updates, decide, moved
from robotkube.delivery.manager.core.updates.targets import Targets
from robotkube.delivery.manager.loops.updates.first_runs import FirstHealthy, FirstRuns
from robotkube.delivery.manager.loops.updates.update_history import UpdateHistory
from robotkube.delivery.manager.ports.cluster import Cluster
from robotkube.errors import DocumentError
from robotkube.foundation.forge.ports.repositories import DeploymentRepository, NoteTexts
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.robots.ros.core.topic_patterns import ros_name

POSTPONEMENTS_MAX = 5
NO_POLICY = UpdatePolicy()
UNREADABLE = f"{PATH} cannot be read; nothing is updated"

_Inputs = tuple[Mapping[str, Release], Targets, UpdatePolicy, UpdateMemory, frozenset[str]]
"""The inputs of `decide`, apart from time and cluster."""

log = logging.getLogger(__name__)


class PolicyReader:
    """A reader of policies/updates.yaml of main; the last good one stays while a newer one is broken."""

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
                log.error("policy not accepted commit=%s problem=%r", tip[:12], str(error))
            self._tip = tip
        return self._policy


class UpdatePlanner:
    """The planner of updates: the versions that the releases keep, and the one update or revert that may be made."""

    def __init__(self, repository: DeploymentRepository, cluster: Cluster, notes: NoteTexts | None = None) -> None:
        """`notes` are those with the outcomes of plans, as the gate writes them."""
        self._first_runs = FirstRuns(notes)
        self._first_healthy = FirstHealthy()
        self._history = UpdateHistory(repository)
        self._policy = PolicyReader(repository)
        self._cluster = cluster
        self._unfit: tuple[str, frozenset[str]] = ("", frozenset())
        self._logged: frozenset[str] = frozenset()
        self._targets = Targets(Catalogue())
        self._postponements = 0
        self._steady: tuple[_Inputs, Updates] | None = None
        self.updates = Updates()

    def decide(
        self,
        present: Mapping[str, Release],
        tip: str,
        catalogue: AssuredCatalogue,
        fleet: Fleet,
        held: Collection[str],
        now_ns: int,
    ) -> Updates:
        """Decide about main's releases (`present`, by path) at its `tip`; messages of the decision are logged once.
        Agents that hold changes (`held`) count like those that are offline."""
        tips = f"{tip} {catalogue.tip}"
        self._unfit = self._unfit if self._unfit[0] == tips else (tips, frozenset())
        policy = self._policy.read(tip)
        memory = self._history.read(tip)
        if self._targets.catalogue is not catalogue.catalogue:
            self._targets = Targets(catalogue.catalogue)

        def observe() -> ClusterHealth:
            health = cluster_health_of(present, self._cluster.applications(), fleet, held)
            about = events_by_namespace(self._cluster.rule_events(), fleet.agents)
            return replace(
                self._first_healthy.note(present.values(), health, now_ns),
                events=about,
                watchers=watchers_of(present.values(), fleet.agents),
                probes=self._probes(present.values(), memory),
                ros_names={agent.namespace: ros_name(agent.name) for agent in fleet.agents.values()},
            )

        inputs = present, self._targets, policy or NO_POLICY, memory, self._unfit[1]
        updates = self._decided(inputs, observe, now_ns)
        self.updates = updates if policy else replace(updates, move=None, messages=(UNREADABLE,))
        for text in sorted(frozenset(self.updates.messages) - self._logged):
            log.info("update text=%r", text)
        self._logged = frozenset(self.updates.messages)
        return self.updates

    def _probes(self, present: Iterable[Release], memory: UpdateMemory) -> dict[str, ProbeAnswers]:
        """The answers of probes by key, of the updated releases whose version is measured by them."""
        answers = {}
        losses = self._cluster.probe_losses()
        for release in present:
            run = memory.runs.get(release.chart)
            version = self._targets.catalogue.version(release.chart, release.version)
            measure = version.success if version is not None else None
            if run is not None and release.key in run.before and measure is not None and measure.probes_of:
                own = [loss for loss in losses if loss.release == release.key]
                answers[release.key] = probe_answers(self._cluster.pods(release.key), own)
        return answers

    def _decided(self, inputs: _Inputs, observe: Callable[[], ClusterHealth], now_ns: int) -> Updates:
        """The decision of `core.updates.decide`. When nothing is under way (then it does not call `observe`), neither
        time nor cluster count: the decision is the same for the same objects."""
        if self._steady and all(before is now for before, now in zip(self._steady[0], inputs, strict=True)):
            return self._steady[1]
        observed: list[ClusterHealth] = []

        def observe_and_note() -> ClusterHealth:
            observed.append(observe())
            return observed[0]

        present, targets, policy, memory, unfit = inputs
        updates = decide(present, targets, policy, memory, observe_and_note, now_ns, unfit, self._first_runs.ran_before)
        self._first_runs.note(present.values(), updates.succeeded, now_ns)
        self._steady = None if observed else (inputs, updates)
        return updates

    def step(
        self,
        steady: Composition,
        present: Mapping[str, Release],
        others_wait: bool,
        compose: Callable[[Mapping[str, Pin]], Composition],
    ) -> tuple[Move, tuple[Change, ...]] | None:
        """The move that was decided and its changes, tried by composing with its pins. None when there is none, when it
        does not fit (which is logged, and not tried again before main or catalogue change), and while changes that
        tasks ask for wait: these come before an update, though at most POSTPONEMENTS_MAX times; a revert waits for
        nothing."""
        move = self.updates.move
        if move is None:
            return None
        if others_wait and move.cause == UPDATE and self._postponements < POSTPONEMENTS_MAX:
            self._postponements += 1
            return None
        self._postponements = 0
        changes, problem = moved(move, compose(move.pins), steady, present)
        if not changes:
            self.unfit(move, problem)
            return None
        return move, changes

    def unfit(self, move: Move, problem: str) -> None:
        """Log why a move cannot be made; it is not tried again before main or catalogue change."""
        log.warning("update not made text=%r", problem)
        self._unfit = (self._unfit[0], self._unfit[1] | frozenset(move.keys))


def cluster_health_of(
    present: Mapping[str, Release],
    applications: Mapping[str, ApplicationState],
    fleet: Fleet,
    held: Collection[str] = (),
) -> ClusterHealth:
    """The health of main's releases, and the agents' namespaces that can be reached and are not `held`."""
    health = {}
    for release in present.values():
        application = applications.get(application_name(release.namespace, release.name))
        health[release.key] = _health(application, release)
    online = {}
    for name, agent in fleet.agents.items():
        ready = [node.ready_since or 0 for node in fleet.nodes.get(name, ()) if node.ready]
        if ready and name not in held:
            online[agent.namespace] = min(ready)
    return ClusterHealth(health, online)


def _health(application: ApplicationState | None, release: Release) -> ReleaseHealth:
    verdict = judge_present(application, release.plan)
    if application is None or not verdict.synced:
        return ReleaseHealth(PROGRESSING)
    if verdict.done:
        return ReleaseHealth(HEALTHY, application.health_since)
    return ReleaseHealth(DEGRADED if application.health == "Degraded" else PROGRESSING, application.health_since)
