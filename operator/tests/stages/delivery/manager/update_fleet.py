"""A fleet whose main and cluster are one, for the rules of updates: what is decided is done, tests say its health."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from robotkube.delivery.deployment.core.policies.updates import UpdatePolicy, UpdateRule
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.updates.cluster_health import (
    HEALTHY,
    PROGRESSING,
    SECOND_NS,
    ClusterHealth,
    ReleaseHealth,
)
from robotkube.delivery.manager.core.updates.memory import UpdateMemory
from robotkube.delivery.manager.core.updates.probe_answers import SAID_NO, ProbeAnswers, ProbeFault
from robotkube.delivery.manager.core.updates.rule_events import RuleEvent, Watcher
from robotkube.delivery.manager.core.updates.steps import Move, Updates, decide
from robotkube.delivery.manager.core.updates.targets import Targets
from robotkube.registry.catalogue.core.applications import Application, ChartRequirement, PlacementRule, Service
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.catalogue.core.chart_versions import ChartVersion

TOGETHER = UpdatePolicy(UpdateRule(canary=False))
CANARY = UpdateRule(canary=True, success_seconds=30, failure_seconds=100)
DETECTION, BRIDGE = "object-detection", "mqtt-bridge"


def version(chart: str, number: str, state: str = "verified") -> ChartVersion:
    return ChartVersion(chart, number, state, f"sha256:{chart}-{number}")


def application(name: str, chart: str, versions: str = "") -> Application:
    service = Service(name, name, ChartRequirement(chart, versions), PlacementRule(), {})
    return Application(name, name, (), {}, (service,))


def catalogue(*versions: ChartVersion) -> Catalogue:
    charts: dict[str, tuple[ChartVersion, ...]] = {}
    for one in versions:
        charts[one.chart] = (*charts.get(one.chart, ()), one)
    offered = {name: application(name, name) for name in charts}
    return Catalogue(offered, charts, "none")


OLD, NEW = version(DETECTION, "0.1.0"), version(DETECTION, "0.2.0")
BRIDGES = version(BRIDGE, "0.1.0")
BOTH = catalogue(OLD, NEW, BRIDGES)


def release(agent: str, version: ChartVersion = OLD) -> Release:
    return Release(agent, version.chart, version.chart, version.version, version.digest, {"of": agent})


ROS_NAMES = {f"vehicle-{number:02d}": f"vehicle_{number:02d}" for number in range(10)}


@dataclass
class Fleet:
    """Main and cluster as one: applies what is decided, and answers with the health that a test sets."""

    agents: tuple[str, ...]
    policy: UpdatePolicy = field(default_factory=lambda: UpdatePolicy(CANARY))
    catalogue: Catalogue = BOTH
    now: int = 1000
    memory: UpdateMemory = field(default_factory=UpdateMemory)
    main: dict[str, Release] = field(default_factory=dict)
    health: dict[str, ReleaseHealth] = field(default_factory=dict)
    online: dict[str, int] = field(default_factory=dict)
    commits: list[Move] = field(default_factory=list)
    ran: set[str] = field(default_factory=set)
    events: dict[str, list[RuleEvent]] = field(default_factory=dict)
    watchers: list[Watcher] = field(default_factory=list)
    probes: dict[str, ProbeAnswers] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for agent in self.agents:
            for version in (OLD, BRIDGES):
                one = release(agent, version)
                self.main[one.path] = one
                self.health[one.key] = ReleaseHealth(HEALTHY, 0)
            self.online[agent] = 0

    def decide(self) -> Updates:
        def observe() -> ClusterHealth:
            return ClusterHealth(self.health, self.online, self.events, self.watchers, self.probes, ROS_NAMES)

        def ran_before(release: Release, commit: str, before_ns: int) -> bool:
            assert commit
            return release.key in self.ran

        inputs = self.main, Targets(self.catalogue), self.policy, self.memory, observe, self.now * SECOND_NS
        return decide(*inputs, ran_before=ran_before)

    def commit(self) -> Move | None:
        """One plan, if there is one to make: what it moves starts anew."""
        move = self.decide().move
        if move is None:
            return None
        before = {}
        for path, one in self.main.items():
            chart, number = move.pins[one.key]
            version = self.catalogue.version(chart, number)
            assert version is not None
            if version.digest != one.digest:
                before[one.key] = (one.chart, one.version)
                self.main[path] = replace(one, version=version.version, digest=version.digest)
                self.health[one.key] = ReleaseHealth(PROGRESSING, self.now * SECOND_NS)
        assert set(before) == set(move.keys)
        at_ns = self.now * SECOND_NS
        if move.cause == "update":
            version = self.catalogue.version(move.chart, move.version)
            assert version is not None
            made = (f"commit {len(self.commits)}", at_ns)
            self.memory = self.memory.updated(move.chart, (move.version, version.digest), before, made)
        elif move.undone:
            self.memory = self.memory.reverted(move.chart, move.keys, move.reason)
        else:
            self.memory = self.memory.taken_back(move.chart, move.keys, move.reason)
        self.commits.append(move)
        return move

    def show(self, key: str, state: str) -> None:
        before = self.health.get(key)
        first = before.first_ns if before is not None else None
        since = self.now * SECOND_NS
        self.health[key] = ReleaseHealth(state, since, since if first is None and state == HEALTHY else first)

    def fault(self, key: str, container: str, restarted: bool = False) -> None:
        """A probe says no, or a container starts again, now."""
        answers = self.probes[key]
        fault = ProbeFault(container, self.now * SECOND_NS, "ended" if restarted else SAID_NO, restarted)
        self.probes[key] = replace(answers, faults=(*answers.faults, fault))

    def event(self, namespace: str, rule: str, ongoing: bool = False) -> None:
        event = RuleEvent(rule, self.now * SECOND_NS, namespace, ongoing=ongoing)
        self.events.setdefault(namespace, []).append(event)

    def versions(self, chart: str = DETECTION) -> dict[str, str]:
        return {one.namespace: one.version for one in self.main.values() if one.chart == chart}


VEHICLES = ("vehicle-00", "vehicle-01", "vehicle-02")
