"""Updates: the steps by which releases get a newer version of their chart, and by which they go back.

A new version moves nothing by itself: every release keeps the version that main gives it (`Updates.pins`) until its
chart's rule lets it move, one chart at a time, in a plan of its own; neighbours of other charts are not part of it.
With a canary the releases of one agent go first, the others when those have succeeded. An update that fails is reverted
to exactly the versions it replaced, and its digest is not tried again until people change the policy. An agent
that is offline neither decides nor waits for anybody: its releases move when it is back.

Nothing is remembered here: `UpdateMemory` is read from main's commits, health and times from the cluster.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cached_property
from typing import Self

from robotkube.delivery.deployment.core.commit_messages import REVERT, UPDATE
from robotkube.delivery.deployment.core.policies.updates import UpdatePolicy, UpdateRule
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.composer import Composition, Met, Refused
from robotkube.delivery.manager.core.plans import Change, differences
from robotkube.registry.catalogue.core.applications import ChartRequirement
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.guarantees import shortfall
from robotkube.registry.catalogue.core.versions import in_range, version_key

HEALTHY = "healthy"
DEGRADED = "degraded"
PROGRESSING = "progressing"
SECOND_NS = 1_000_000_000
NOTICED_SECONDS_MAX = 60  # a failure is noticed within this time, whatever the bounds of the rule

Pin = tuple[str, str]
"""Chart and version."""


@dataclass(frozen=True)
class ChartUpdate:
    """The last update of a chart on main: its target, per release what it replaced and when (ns since 1970), and its
    commits."""

    version: str
    digest: str
    before: Mapping[str, Pin] = field(default_factory=dict)
    at_ns: Mapping[str, int] = field(default_factory=dict)
    commits: tuple[str, ...] = ()


@dataclass(frozen=True)
class UpdateMemory:
    """The updates in main's commits: the last run by chart; digests that were reverted, with the reason."""

    runs: Mapping[str, ChartUpdate] = field(default_factory=dict)
    barred: Mapping[str, str] = field(default_factory=dict)

    def updated(self, chart: str, target: tuple[str, str], before: Mapping[str, Pin], made: tuple[str, int]) -> Self:
        """The memory after a commit that updated the releases in `before` to `target` (version and digest); `made` is
        the commit's id and its time in ns."""
        known = self.runs.get(chart)
        run = known if known is not None and known.digest == target[1] else ChartUpdate(*target)
        times = {**run.at_ns, **dict.fromkeys(before, made[1])}
        run = ChartUpdate(*target, {**run.before, **before}, times, (*run.commits, made[0]))
        return replace(self, runs={**self.runs, chart: run})

    def reverted(self, chart: str, keys: Iterable[str], why: str) -> Self:
        """The memory after a commit that reverted the last update of a chart for `keys`; its others are still due."""
        run = self.runs.get(chart)
        if run is None:
            return self
        left = {key: pin for key, pin in run.before.items() if key not in set(keys)}
        return replace(
            self, runs={**self.runs, chart: replace(run, before=left)}, barred={**self.barred, run.digest: why}
        )

    def policy_changed(self) -> Self:
        """The memory after people changed policies/updates.yaml: what was reverted may be tried again."""
        return replace(self, barred={})


@dataclass(frozen=True)
class ReleaseHealth:
    """The health of a release in the cluster: healthy (Synced and Healthy as main has it), degraded or progressing;
    since when in ns, None when nobody knows."""

    state: str
    since_ns: int | None = None


@dataclass(frozen=True)
class ClusterHealth:
    """The cluster as far as updates depend on it: `health` by release key; `online`: namespace -> since when (ns; 0 =
    always) a node of its agent is ready."""

    health: Mapping[str, ReleaseHealth] = field(default_factory=dict)
    online: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Move:
    """The one step that may be made now, of `cause` update or revert: `keys` are the releases that go to `version` or
    leave it; `pins` those of all releases with this step made; `reason` for commit and pull request; `undone` the
    commits that a revert undoes."""

    cause: str
    chart: str
    version: str
    keys: tuple[str, ...]
    pins: Mapping[str, Pin]
    reason: str
    undone: tuple[str, ...] = ()


@dataclass(frozen=True)
class Updates:
    """The decision about updates. `pins`: release key -> what it keeps; `withheld`: (chart, version) -> why nothing new
    may use it; `messages` say what waits for what."""

    pins: Mapping[str, Pin] = field(default_factory=dict)
    withheld: Mapping[Pin, str] = field(default_factory=dict)
    move: Move | None = None
    messages: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Rollout:
    """Releases of one chart under one rule, and the version they should all have."""

    chart: str
    target: ChartVersion
    rule: UpdateRule
    behind: tuple[Release, ...]
    updated: tuple[Release, ...]


@dataclass(frozen=True)
class _Tally:
    """The updated releases of agents that are online, by verdict."""

    good: tuple[str, ...] = ()
    bad: tuple[str, ...] = ()
    pending: tuple[str, ...] = ()

    def failed(self, rule: UpdateRule) -> bool:
        """Whether fewer than the rule's share can still succeed."""
        count = len(self.good) + len(self.bad) + len(self.pending)
        return bool(self.bad) and (count - len(self.bad)) < rule.threshold * count

    def succeeded(self, rule: UpdateRule) -> bool:
        """Whether the rule's share has succeeded."""
        count = len(self.good) + len(self.bad) + len(self.pending)
        return bool(self.good) and len(self.good) >= rule.threshold * count


class Targets:
    """The newest version of each chart in one catalogue, searched once."""

    def __init__(self, catalogue: Catalogue) -> None:
        self.catalogue = catalogue
        self._known: dict[tuple[str, tuple[str, ...], frozenset[str]], ChartVersion | None] = {}
        self._bridges = [a for a in catalogue.applications.values() if a.bridges]

    def newest(self, chart: str, applications: tuple[str, ...], barred: frozenset[str]) -> ChartVersion | None:
        """The newest version that the release policy allows, that is not `barred` (digests), and that a service of the
        applications (empty: of any) can use."""
        question = chart, applications, barred
        if question not in self._known:
            self._known[question] = self._find(*question)
        return self._known[question]

    @cached_property
    def highest(self) -> Mapping[str, str]:
        """The highest version of each chart, whoever may use it."""
        charts = self.catalogue.charts.items()
        return {chart: max((v.version for v in versions), key=version_key) for chart, versions in charts if versions}

    def _find(self, chart: str, applications: tuple[str, ...], barred: frozenset[str]) -> ChartVersion | None:
        known = self.catalogue.applications
        chosen = [known[name] for name in applications if name in known]
        offering = [*chosen, *self._bridges] if chosen else list(known.values())
        wanted = {service.chart for application in offering for service in application.services}
        versions = self.catalogue.charts.get(chart, ())
        for version in sorted(versions, key=lambda version: version_key(version.version), reverse=True):
            suits = any(_suits(version, requirement) for requirement in wanted)
            if suits and version.digest not in barred and not self.catalogue.allows(version):
                return version
        return None


def _suits(version: ChartVersion, requirement: ChartRequirement) -> bool:
    named = requirement.name == version.chart or (not requirement.name and requirement.provides in version.provides)
    weak = any(shortfall(guarantee, version.guarantees) for guarantee in requirement.requirements)
    return named and not weak and in_range(version.version, requirement.version)


def decide(
    present: Mapping[str, Release],
    targets: Targets,
    policy: UpdatePolicy,
    memory: UpdateMemory,
    observe: Callable[[], ClusterHealth],
    now_ns: int,
    fixed: frozenset[str] = frozenset(),
) -> Updates:
    """The version that every release on main (`present`, by path) keeps, and the one update or revert that may be made
    now: reverts first, then by chart. `fixed`: release keys that cannot move (a newer version does not suit them).
    `observe` is called only when something is under way."""
    pins = {release.key: (release.chart, release.version) for release in present.values()}
    withheld = _withheld(targets.catalogue, memory)
    moves = list(_left_over(present.values(), memory, pins))
    messages: list[str] = []
    rollouts = _rollouts(present.values(), targets, policy, memory)
    cluster_health = observe() if rollouts else ClusterHealth()
    for rollout in rollouts:
        tally = _tally(rollout, memory.runs.get(rollout.chart), cluster_health, now_ns)
        if rollout.behind and rollout.rule.canary and not tally.succeeded(rollout.rule):
            on_trial = f"{rollout.target.chart} {rollout.target.version} is on trial"
            withheld[rollout.chart, rollout.target.version] = f"{on_trial}; it is used when its canary has succeeded"
        if tally.failed(rollout.rule):
            step, text = _failed(rollout, tally, memory.runs[rollout.chart], present.values(), pins)
        else:
            step, text = _forward(rollout, tally, cluster_health, fixed, pins)
        moves += [step] if step else []
        messages += [text] if text else []
    chosen = min(moves, key=lambda move: (move.cause != REVERT, move.chart), default=None)
    return Updates(pins, withheld, chosen, tuple(messages))


def _withheld(catalogue: Catalogue, memory: UpdateMemory) -> dict[Pin, str]:
    """The versions that were reverted, with the reason."""
    if not memory.barred:
        return {}
    versions = itertools.chain.from_iterable(catalogue.charts.values())
    return {(v.chart, v.version): memory.barred[v.digest] for v in versions if v.digest in memory.barred}


def _rollouts(
    present: Iterable[Release], targets: Targets, policy: UpdatePolicy, memory: UpdateMemory
) -> list[_Rollout]:
    """The rollouts: every chart and rule under which a release is behind, or was moved by the chart's last update."""
    barred = frozenset(memory.barred)
    rollouts: dict[tuple[str, str, str], _Rollout] = {}
    current = targets.highest
    moving = [r for r in present if r.chart in memory.runs or current.get(r.chart) != r.version]
    for release in sorted(moving, key=lambda release: release.key):
        applications = tuple(sorted({cause.application for cause in release.causes}))
        target = targets.newest(release.chart, applications, barred)
        run = memory.runs.get(release.chart)
        if target is None:
            continue
        differs = release.version != target.version
        behind = differs and version_key(release.version) < version_key(target.version)
        updated = run is not None and release.digest == run.digest == target.digest and release.key in run.before
        if behind or updated:
            name, rule = policy.rule(release)
            place = release.chart, name, target.version
            rollout = rollouts.get(place) or _Rollout(release.chart, target, rule, (), ())
            if behind:
                rollouts[place] = replace(rollout, behind=(*rollout.behind, release))
            else:
                rollouts[place] = replace(rollout, updated=(*rollout.updated, release))
    return [rollouts[place] for place in sorted(rollouts)]


def _tally(rollout: _Rollout, run: ChartUpdate | None, cluster_health: ClusterHealth, now_ns: int) -> _Tally:
    verdicts: dict[str, list[str]] = {"good": [], "bad": [], "pending": []}
    for release in rollout.updated:
        online = cluster_health.online.get(release.namespace)
        if run is not None and online is not None:
            at_ns = run.at_ns[release.key]
            begin_ns = max(at_ns, online, plan_ns(release.plan))
            verdict = _verdict(cluster_health.health.get(release.key), at_ns, begin_ns, rollout.rule, now_ns)
            verdicts[verdict].append(release.key)
    return _Tally(*(tuple(verdicts[name]) for name in ("good", "bad", "pending")))


def _verdict(health: ReleaseHealth | None, at_ns: int, begin_ns: int, rule: UpdateRule, now_ns: int) -> str:
    """The verdict (good, bad or pending) about a release that was updated at `at_ns` and could run since `begin_ns`
    (its agent came back, or a later plan changed it again). Trouble that began long after the update is not its
    doing."""
    state = health.state if health else PROGRESSING
    known = health.since_ns if health else None
    if state == HEALTHY:
        healthy_since = max(known if known is not None else begin_ns, begin_ns)
        return "good" if now_ns - healthy_since >= rule.success_seconds * SECOND_NS else "pending"
    since = now_ns if known is None else known
    late = now_ns - begin_ns >= rule.failure_seconds * SECOND_NS
    newly_degraded = state == DEGRADED and since >= begin_ns
    blamed_ns = at_ns + (2 * rule.failure_seconds + rule.success_seconds + NOTICED_SECONDS_MAX) * SECOND_NS
    return "bad" if (late or newly_degraded) and since < blamed_ns else "pending"


def plan_ns(plan: str) -> int:
    """The time in a plan's id, in ns since 1970; 0 when it is none."""
    try:
        return int(datetime.strptime(plan[:15], "%Y%m%d-%H%M%S").replace(tzinfo=UTC).timestamp()) * SECOND_NS
    except ValueError:
        return 0


def _failed(
    rollout: _Rollout, tally: _Tally, run: ChartUpdate, present: Iterable[Release], pins: Mapping[str, Pin]
) -> tuple[Move | None, str]:
    """The revert of an update, for every release that it moved, under whatever rule; only a message when the rule
    forbids it."""
    rule = rollout.rule
    name = f"{rollout.chart} {rollout.target.version}"
    bad = ", ".join(tally.bad)
    fault = f"{bad} degraded, or not healthy within {rule.failure_seconds} s"
    if not rule.revert:
        return None, f"{name} has failed ({fault}); it goes no further, and is not reverted since the policy says so"
    keys = tuple(sorted(r.key for r in present if r.key in run.before and r.digest == run.digest))
    back = {key: run.before[key] for key in keys}
    reason = f"{name} back: {fault}"
    move = Move(REVERT, rollout.chart, rollout.target.version, keys, {**pins, **back}, reason, run.commits)
    return move, f"{name} has failed ({fault}) and is reverted"


def _left_over(present: Iterable[Release], memory: UpdateMemory, pins: Mapping[str, Pin]) -> Iterable[Move]:
    """The reverts of releases that could not go back with the others, since a device held them."""
    for chart, run in sorted(memory.runs.items()):
        left = [r for r in present if r.chart == chart and r.digest == run.digest and r.key in run.before]
        if left and run.digest in memory.barred:
            keys = tuple(sorted(release.key for release in left))
            back = {key: run.before[key] for key in keys}
            reason = f"{chart} {run.version} back where it could not go before"
            yield Move(REVERT, chart, run.version, keys, {**pins, **back}, reason, run.commits)


def _forward(
    rollout: _Rollout, tally: _Tally, cluster_health: ClusterHealth, fixed: frozenset[str], pins: Mapping[str, Pin]
) -> tuple[Move | None, str]:
    """The next step of an update, and who waits for what."""
    name = f"{rollout.chart} {rollout.target.version}"
    free = [release for release in rollout.behind if release.key not in fixed]
    online = [release for release in free if release.namespace in cluster_health.online]
    offline = sorted({release.namespace for release in free} - set(cluster_health.online))
    text = f"{name} waits for {', '.join(offline)}, which is offline" if offline else ""
    if not online:
        return None, text
    on_trial = rollout.rule.canary and not tally.succeeded(rollout.rule)
    if on_trial and (tally.good or tally.pending or tally.bad):
        waiting = ", ".join((*tally.pending, *tally.bad))
        return None, f"{name} is on trial: {waiting} must be healthy for {rollout.rule.success_seconds} s"
    first = min(online, key=lambda r: (_state(r, cluster_health) != HEALTHY, r.key)).namespace
    keys = tuple(release.key for release in online if not on_trial or release.namespace == first)
    reason = f"{name}, first on {first}" if on_trial else name
    target = (rollout.chart, rollout.target.version)
    return Move(UPDATE, *target, keys, {**pins, **dict.fromkeys(keys, target)}, reason), text


def _state(release: Release, cluster_health: ClusterHealth) -> str:
    return cluster_health.health[release.key].state if release.key in cluster_health.health else PROGRESSING


def moved(
    move: Move, trial: Composition, steady: Composition, present: Mapping[str, Release]
) -> tuple[tuple[Change, ...], str]:
    """The changes of one step, or why there are none. `trial` was composed with `move.pins`, `steady` with the pins of
    main, which `present` is. Nothing but the releases of the step may differ, and no demand may lose by it."""
    lost = [
        f"{key}: {outcome.message}"
        for key, outcome in trial.outcomes.items()
        if isinstance(outcome, Refused) and isinstance(steady.outcomes.get(key), Met)
    ]
    if lost:
        return (), f"{move.reason} would refuse {'; '.join(lost)}"
    differing = differences(trial.releases, steady.releases)
    others = [change.release.key for change in differing if change.release.key not in move.keys]
    if others:
        return (), f"{move.reason} would change {', '.join(others)} as well"
    changes = []
    for change in differing:
        before, now = steady.releases.get(change.path), present.get(change.path)
        if before is not None and now is not None and before.same_but_plan(now):
            changes.append(Change(change.path, now, trial.releases[change.path]))
    return tuple(changes), "" if changes else f"{move.reason} suits none of {', '.join(move.keys)}"
