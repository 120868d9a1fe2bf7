"""Conflicts between demands: which are refused, which wait, which run elsewhere, which are pre-empted.

A conflict is a demand that could run if others did not: its requests do not fit beside theirs, they have a release that
it needs with other content, or publish one of its topics on the same place. Its own policy says what becomes of it.
Reject: refused. Postpone: it waits in the queue, also for nodes that are missing at the moment. Offload: it is placed
on agents of other roles. Preempt: demands of strictly lower priority give way, as few as possible, the lowest first;
what becomes of those says theirs.

What stands on main keeps its place before anything new; new demands come by priority, which grows while they wait
(AGING_SECONDS). Nothing waits for ever: the queue has QUEUE_MAX places, and who has waited for its `secondsMax` is
refused unless it fits at that moment. A conflict is decided once: `History.settled` keeps refusals until the task is
changed or made anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from robotkube.delivery.manager.core.composition.inputs import Composition, Demand, Met, Refused
from robotkube.delivery.manager.core.standing_demands import moment
from robotkube.delivery.tasks.core.task_description import (
    CONFLICT_REASONS,
    NO_CAPABLE_NODE,
    OFFLOAD,
    POSTPONE,
    PREEMPT,
    PREEMPTED,
    QUEUE_FULL,
    QUEUE_TOO_LONG,
    TaskDescription,
)

QUEUE_MAX = 100
AGING_SECONDS = 1.0  # a waiting demand gains one point of priority in this time
PREEMPTIONS_MAX = 10  # decided at once; the others are decided by the next step
VICTIMS_MAX = 256  # demands of lower priority that are considered for one pre-emption
AWAY_REASONS = CONFLICT_REASONS | {NO_CAPABLE_NODE}  # for which another place or another time may help

Compose = Callable[[Sequence[Demand]], Composition]
"""Meets the demands in the order given; a refused one leaves no trace, and no demand gives way to a later one."""


@dataclass(frozen=True)
class Postponed:
    """Why a demand waits: `reason` is that of the refusal it would have met. `position` counts from 1."""

    reason: str
    message: str
    position: int
    since_ns: int
    until_ns: int


DemandOutcome = Met | Refused | Postponed


@dataclass(frozen=True)
class History:
    """Earlier decisions about the demands' present generations: since when each waits (ns since 1970), refusals that
    stand, demands that were offloaded, demands that main answers; of those, `changed` are ones that asked otherwise."""

    waiting: Mapping[str, int] = field(default_factory=dict)
    settled: Mapping[str, Refused] = field(default_factory=dict)
    offloaded: frozenset[str] = frozenset()
    answered: frozenset[str] = frozenset()
    changed: frozenset[str] = frozenset()

    def without(self, key: str) -> History:
        """The same but for what was decided about one demand, which asks anew."""
        waiting = {k: since for k, since in self.waiting.items() if k != key}
        settled = {k: refused for k, refused in self.settled.items() if k != key}
        return replace(
            self, waiting=waiting, settled=settled, offloaded=self.offloaded - {key}, changed=self.changed | {key}
        )


@dataclass(frozen=True)
class Resolution:
    """The answer: what should be on main, and an outcome per demand. `next_due_ns` is when a waiting demand's time ends
    (None: nobody waits); `undecided` are demands to be decided by the next step, which is due at once."""

    desired: Composition
    outcomes: Mapping[str, DemandOutcome]
    offloaded: frozenset[str] = frozenset()
    undecided: frozenset[str] = frozenset()
    next_due_ns: int | None = None


def resolve(demands: Sequence[Demand], compose: Compose, history: History, now_ns: int) -> Resolution:
    """Compose the demands and settle their conflicts; deterministic for equal inputs."""
    settled = {k: r for k, r in history.settled.items() if k not in history.answered}
    wanted = sorted((d for d in demands if d.key not in settled), key=lambda d: _order(d, history, now_ns))
    wanted = [_offloaded(d) if d.key in history.offloaded else d for d in wanted]
    desired = compose(wanted)
    wanted, desired, why = _offload(wanted, desired, compose)
    wanted, desired, preempted_by, undecided = _preempt(wanted, desired, compose)
    outcomes: dict[str, DemandOutcome] = {
        d.key: _with_conflict(d, desired.outcomes[d.key], why, preempted_by, settled)
        for d in wanted
        if d.key not in undecided
    }
    preempted = {k: by for k, by in preempted_by.items() if not _met(outcomes.get(k))}
    outcomes |= {k: Refused(PREEMPTED, _preempted_text(by)) for k, by in preempted.items()}
    queue = _queue([d for d in demands if d.key in outcomes], outcomes, history, now_ns)
    outcomes |= {**settled, **queue}
    offloaded = frozenset(d.key for d in wanted if d.roles and _met(outcomes[d.key]))
    due = min((o.until_ns for o in queue.values() if isinstance(o, Postponed)), default=None)
    return Resolution(desired, outcomes, offloaded, frozenset(undecided), due)


def _order(demand: Demand, history: History, now_ns: int) -> tuple[int, float, str, str]:
    """Initial configuration, what main answers by its creation (what it answers as it was before comes after, since it
    has no place yet), then new demands by priority."""
    task = demand.task
    if task is None:
        return 0, 0.0, "", demand.key
    if demand.key in history.answered:
        return 1 + (demand.key in history.changed), 0.0, task.created, demand.key
    waited = (now_ns - history.waiting.get(demand.key, now_ns)) / 1e9
    return 3, -(task.priority + waited / AGING_SECONDS), task.created, demand.key


def _met(outcome: DemandOutcome | None) -> bool:
    return isinstance(outcome, Met)


def _policy(demand: Demand) -> str:
    return demand.task.conflict_policy if demand.task else ""


def _priority(demand: Demand) -> int:
    return demand.task.priority if demand.task else 0


# -- elsewhere ----------------------------------------------------------------------------------------------------


def _offloaded(demand: Demand) -> Demand:
    return replace(demand, roles=demand.task.offload_to) if demand.task else demand


def _offload(
    wanted: list[Demand], desired: Composition, compose: Compose
) -> tuple[list[Demand], Composition, Mapping[str, Refused]]:
    """Place those elsewhere whose policy allows it; with each the refusal that it met at its own place."""
    why = {
        d.key: outcome
        for d in wanted
        if _policy(d) == OFFLOAD
        and not d.roles
        and isinstance(outcome := desired.outcomes[d.key], Refused)
        and outcome.reason in AWAY_REASONS
    }
    if not why:
        return wanted, desired, why
    moved = [_offloaded(d) if d.key in why else d for d in wanted]
    return moved, compose(moved), why


# -- pre-emption --------------------------------------------------------------------------------------------------


def _preempt(
    wanted: list[Demand], desired: Composition, compose: Compose
) -> tuple[list[Demand], Composition, dict[str, Demand], set[str]]:
    """Let demands of lower priority give way to those that may pre-empt; which gave way to which, and those that are
    not decided yet."""
    preemptors = [d for d in wanted if _policy(d) == PREEMPT and _reason(desired, d) in CONFLICT_REASONS]
    preempted_by: dict[str, Demand] = {}
    accepted = [d for d in wanted if _met(desired.outcomes[d.key])]
    for preemptor in preemptors[:PREEMPTIONS_MAX]:
        victims = _victims(preemptor, accepted, compose)
        if victims:
            preempted_by |= {victim.key: preemptor for victim in victims}
            accepted = [d for d in accepted if d.key not in preempted_by] + [preemptor]
    if preempted_by:
        before = desired.outcomes
        wanted = _order_after_preemption(wanted, accepted, preempted_by)
        desired = compose(wanted)
        after = desired.outcomes
        stuck = {key for key in preempted_by if key in after and _same_place(before[key], after[key])}
        if stuck:
            wanted = [d for d in wanted if d.key not in stuck]
            desired = compose(wanted)
    return wanted, desired, preempted_by, {d.key for d in preemptors[PREEMPTIONS_MAX:]} - {d.key for d in accepted}


def _reason(desired: Composition, demand: Demand) -> str:
    outcome = desired.outcomes[demand.key]
    return outcome.reason if isinstance(outcome, Refused) else ""


def _same_place(before: Met | Refused, after: Met | Refused) -> bool:
    """Return whether what gave way would stay where it is: what runs may stay though there is no room, so it would."""
    return isinstance(before, Met) and isinstance(after, Met) and before.releases == after.releases


def _order_after_preemption(
    wanted: Iterable[Demand], accepted: list[Demand], preempted_by: Mapping[str, Demand]
) -> list[Demand]:
    """Those that have a place, then the refused ones, then those that gave way and may run elsewhere."""
    placed = {d.key for d in accepted}
    others = [d for d in wanted if d.key not in placed and d.key not in preempted_by]
    elsewhere = [_offloaded(d) for d in wanted if d.key in preempted_by and _policy(d) == OFFLOAD and not d.roles]
    return [*accepted, *others, *elsewhere]


def _victims(preemptor: Demand, accepted: Sequence[Demand], compose: Compose) -> list[Demand]:
    """A smallest set of demands of lower priority without which `preemptor` fits and everybody else stays (QuickXplain,
    Junker 2004, which prefers the first candidates); empty when none is enough."""
    candidates = [d for d in accepted if d.task is not None and _priority(d) < _priority(preemptor)]
    candidates.sort(key=lambda d: (_priority(d), d.key))
    del candidates[VICTIMS_MAX:]

    def fits(victims: Iterable[Demand]) -> bool:
        away = {d.key for d in victims}
        trial = [*(d for d in accepted if d.key not in away), preemptor]
        outcomes = compose(trial).outcomes
        return all(_met(outcomes[d.key]) for d in trial)

    def smallest(given: list[Demand], added: bool, among: list[Demand]) -> list[Demand]:
        if added and fits(given):
            return []
        if len(among) == 1:
            return among
        half = len(among) // 2
        preferred, others = among[:half], among[half:]
        needed = smallest([*given, *preferred], True, others)
        return smallest([*given, *needed], bool(needed), preferred) + needed

    return smallest([], False, candidates) if candidates and fits(candidates) else []


def _by(refused: Refused, preemptor: Demand) -> bool:
    return refused.reason == PREEMPTED and refused.message == _preempted_text(preemptor)


def _preempted_text(preemptor: Demand) -> str:
    return f"gave way to {preemptor.key} of priority {_priority(preemptor)}"


# -- messages and the queue ---------------------------------------------------------------------------------------


def _with_conflict(
    demand: Demand,
    outcome: Met | Refused,
    why: Mapping[str, Refused],
    preempted_by: Mapping[str, Demand],
    settled: Mapping[str, Refused],
) -> Met | Refused:
    """The outcome with what was decided about its conflict in its message or choices."""
    if not (why or preempted_by or settled or demand.roles):
        return outcome
    refusal = why.get(demand.key)
    if isinstance(outcome, Refused):
        text = f"{refusal.message}; on {_elsewhere(demand)} instead: {outcome.message}" if refusal else outcome.message
        return replace(outcome, message=text)
    before = [key for key, earlier in settled.items() if _by(earlier, demand)]
    now = [key for key, preemptor in preempted_by.items() if preemptor.key == demand.key]
    choices = [f"{key} gave way to it" for key in sorted({*before, *now})]
    if demand.roles:
        reason = f": {refusal.reason}: {refusal.message}" if refusal else ""
        by = f"; it {_preempted_text(preempted_by[demand.key])}" if demand.key in preempted_by else ""
        choices.append(f"offloaded to {_elsewhere(demand)}{by}{reason}")
    return replace(outcome, choices=(*choices, *outcome.choices)) if choices else outcome


def _elsewhere(demand: Demand) -> str:
    return ", ".join(demand.roles)


def _queue(
    demands: Sequence[Demand], outcomes: Mapping[str, DemandOutcome], history: History, now_ns: int
) -> dict[str, DemandOutcome]:
    """Places of those that wait: who waits already keeps its place; the others take what is left, in their order."""
    waiting = [d.task for d in demands if d.task and _waits(d, outcomes[d.key])]
    if not waiting:
        return {}
    end = {t.key: history.waiting.get(t.key, now_ns) + t.queue_seconds_max * 1_000_000_000 for t in waiting}
    queued: dict[str, DemandOutcome] = {t.key: _too_long(t, outcomes[t.key]) for t in waiting if end[t.key] <= now_ns}
    as_new = replace(history, answered=frozenset())
    by_order = {d.key: _order(d, as_new, now_ns) for d in demands}
    line = sorted((t for t in waiting if t.key not in queued), key=lambda t: by_order[t.key])
    known = [t for t in line if t.key in history.waiting]
    places = {t.key for t in [*known, *(t for t in line if t.key not in history.waiting)][:QUEUE_MAX]}
    queued |= {t.key: _full(outcomes[t.key]) for t in line if t.key not in places}
    line = [t for t in line if t.key in places]
    for position, task in enumerate(line, 1):
        since = history.waiting.get(task.key, now_ns)
        queued[task.key] = _postponed(outcomes[task.key], position, len(line), since, end[task.key])
    return queued


def _waits(demand: Demand, outcome: DemandOutcome) -> bool:
    return _policy(demand) == POSTPONE and isinstance(outcome, Refused) and outcome.reason in AWAY_REASONS | {PREEMPTED}


def _reason_and_message(outcome: DemandOutcome) -> tuple[str, str]:
    return (outcome.reason, outcome.message) if isinstance(outcome, Refused) else ("", "")


def _too_long(task: TaskDescription, outcome: DemandOutcome) -> Refused:
    return Refused(QUEUE_TOO_LONG, f"waited for {task.queue_seconds_max} s: {': '.join(_reason_and_message(outcome))}")


def _full(outcome: DemandOutcome) -> Refused:
    return Refused(QUEUE_FULL, f"{QUEUE_MAX} demands wait already: {': '.join(_reason_and_message(outcome))}")


def _postponed(outcome: DemandOutcome, position: int, length: int, since_ns: int, until_ns: int) -> Postponed:
    reason, message = _reason_and_message(outcome)
    text = f"waits at position {position} of {length} until {moment(until_ns)}: {reason}: {message}"
    return Postponed(reason, text, position, since_ns, until_ns)
