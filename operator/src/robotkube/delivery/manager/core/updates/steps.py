"""Updates: the steps by which releases get a newer version of their chart, and by which they go back.

A new version moves nothing by itself: every release keeps the version that main gives it (`Updates.pins`) until its
chart's rule lets it move, one chart at a time, in a plan of its own; neighbours of other charts are not part of it.
Where several agents have the chart, the releases of one go first, the others when those have succeeded. An update that
fails is reverted to exactly the versions it replaced, and its digest is not tried again until people change the policy.
An agent that is offline neither decides nor waits for anybody: its releases move when it is back. When the version
fails there, and has succeeded with others, it is taken back for this agent alone.

Nothing is remembered here: `UpdateMemory` is read from main's commits, health and times from the cluster.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from robotkube.delivery.deployment.core.commit_messages import REVERT, UPDATE
from robotkube.delivery.deployment.core.policies.updates import UpdatePolicy
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.composer import Composition, Met, Refused
from robotkube.delivery.manager.core.plans import Change, differences
from robotkube.delivery.manager.core.updates.cluster_health import ClusterHealth
from robotkube.delivery.manager.core.updates.memory import ChartUpdate, Pin, UpdateMemory
from robotkube.delivery.manager.core.updates.rollouts import Rollout, rollouts_of
from robotkube.delivery.manager.core.updates.states import ReleaseUpdate, states_of
from robotkube.delivery.manager.core.updates.targets import Targets
from robotkube.delivery.manager.core.updates.verdicts import RanBefore, Trial, nobody_knows, try_out
from robotkube.registry.catalogue.core.catalogue import Catalogue


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
    may use it; `messages` say what waits for what, `states` by release key what an update does with it;
    `succeeded` have the newest version, and it has succeeded there."""

    pins: Mapping[str, Pin] = field(default_factory=dict)
    withheld: Mapping[Pin, str] = field(default_factory=dict)
    move: Move | None = None
    messages: tuple[str, ...] = ()
    states: Mapping[str, ReleaseUpdate] = field(default_factory=dict)
    succeeded: frozenset[str] = frozenset()


def decide(
    present: Mapping[str, Release],
    targets: Targets,
    policy: UpdatePolicy,
    memory: UpdateMemory,
    observe: Callable[[], ClusterHealth],
    now_ns: int,
    fixed: frozenset[str] = frozenset(),
    ran_before: RanBefore = nobody_knows,
) -> Updates:
    """The version that every release on main (`present`, by path) keeps, and the one update or revert that may be made
    now: reverts first, then by chart. `fixed`: release keys that cannot move (a newer version does not suit them).
    `observe` is called only when something is under way, `ran_before` when a release fails on an agent that was
    away."""
    pins = {release.key: (release.chart, release.version) for release in present.values()}
    withheld = _withheld(targets.catalogue, memory)
    moves = list(_left_over(present.values(), memory, pins))
    messages: list[str] = []
    states: dict[str, ReleaseUpdate] = {}
    succeeded: set[str] = set()
    rollouts = rollouts_of(present.values(), targets, policy, memory)
    cluster_health = observe() if rollouts else ClusterHealth()
    for rollout in rollouts:
        run = memory.runs.get(rollout.chart)
        trial = try_out(rollout.updated, run, cluster_health, rollout.terms, now_ns, ran_before)
        if rollout.on_trial(trial) and (trial.begun or rollout.free(cluster_health, fixed)):
            why = f"{rollout.name} is on trial; it is used when its canary has succeeded"
            withheld[rollout.chart, rollout.target.version] = why
        if run is not None and trial.failed(rollout.rule):
            steps = [_failed(rollout, trial, run, present.values(), pins)]
        else:
            steps = [_forward(rollout, trial, cluster_health, fixed, pins)]
        if run is not None and trial.late and trial.succeeded(rollout.rule):
            steps.append(_taken_back(rollout, trial, run, present.values(), pins))
        states |= states_of(rollout, trial, cluster_health, fixed, memory)
        succeeded |= set(trial.good)
        moves += [move for move, _ in steps if move]
        messages += [text for _, text in steps if text]
    chosen = min(moves, key=lambda move: (move.cause != REVERT, move.chart), default=None)
    return Updates(pins, withheld, chosen, tuple(messages), states, frozenset(succeeded))


def _withheld(catalogue: Catalogue, memory: UpdateMemory) -> dict[Pin, str]:
    """The versions that were reverted, with the reason."""
    if not memory.barred:
        return {}
    versions = itertools.chain.from_iterable(catalogue.charts.values())
    return {(v.chart, v.version): memory.barred[v.digest] for v in versions if v.digest in memory.barred}


def _failed(
    rollout: Rollout, trial: Trial, run: ChartUpdate, present: Iterable[Release], pins: Mapping[str, Pin]
) -> tuple[Move | None, str]:
    """The revert of an update, for every release that it moved, under whatever rule; only a message when the rule
    forbids it."""
    rule = rollout.rule
    name = rollout.name
    fault = _fault((*trial.bad, *trial.late), trial)
    if not rule.revert:
        return None, f"{name} has failed ({fault}); it goes no further, and is not reverted since the policy says so"
    keys = tuple(sorted(r.key for r in present if r.key in run.before and r.digest == run.digest))
    back = {key: run.before[key] for key in keys}
    reason = f"{name} back: {fault}"
    move = Move(REVERT, rollout.chart, rollout.target.version, keys, {**pins, **back}, reason, run.commits)
    return move, f"{name} has failed ({fault}) and is reverted"


def _taken_back(
    rollout: Rollout, trial: Trial, run: ChartUpdate, present: Iterable[Release], pins: Mapping[str, Pin]
) -> tuple[Move | None, str]:
    """The revert of an update for the agents that came back late, and on which it failed; it undoes no whole commit."""
    agents = {key.partition("/")[0] for key in trial.late}
    name = f"{rollout.name} back on {', '.join(sorted(agents))}"
    fault = _fault(trial.late, trial)
    if not rollout.rule.revert:
        return None, f"{rollout.name} has failed ({fault}); it is not reverted since the policy says so"
    gone = [r for r in present if r.key in run.before and r.digest == run.digest and r.namespace in agents]
    keys = tuple(sorted(release.key for release in gone))
    back = {key: run.before[key] for key in keys}
    move = Move(REVERT, rollout.chart, rollout.target.version, keys, {**pins, **back}, f"{name}: {fault}")
    return move, f"{rollout.name} has failed ({fault}) and is taken back there"


def _fault(keys: Sequence[str], trial: Trial) -> str:
    """The faults of releases, those with the same one together."""
    faults = dict.fromkeys(trial.reasons[key] for key in keys)
    return "; ".join(f"{', '.join(k for k in keys if trial.reasons[k] == fault)} {fault}" for fault in faults)


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
    rollout: Rollout, trial: Trial, cluster_health: ClusterHealth, fixed: frozenset[str], pins: Mapping[str, Pin]
) -> tuple[Move | None, str]:
    """The next step of an update, and who waits for what."""
    online = rollout.free(cluster_health, fixed)
    reachable = {release.namespace for release in rollout.behind if release.key not in fixed}
    offline = sorted(reachable - set(cluster_health.online))
    text = f"{rollout.name} waits for {', '.join(offline)}, which is offline" if offline else ""
    if not online:
        return None, text
    on_trial = rollout.on_trial(trial)
    if on_trial and trial.begun:
        return None, f"{rollout.name} is on trial: {_fault(trial.unsettled, trial)}"
    first = rollout.first(online, cluster_health)
    keys = tuple(release.key for release in online if not on_trial or release.namespace == first)
    reason = f"{rollout.name}, first on {first}" if on_trial else rollout.name
    target = (rollout.chart, rollout.target.version)
    return Move(UPDATE, *target, keys, {**pins, **dict.fromkeys(keys, target)}, reason), text


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
