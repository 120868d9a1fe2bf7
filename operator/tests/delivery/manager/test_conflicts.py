"""Conflicts: who is refused, waits, runs elsewhere, gives way; on places of slots, so that only the rules are tested.

A demand needs as many slots of its place as its parameter says; its releases do not matter here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.manager.core.composition.inputs import Composition, Demand, Met, Refused
from robotkube.delivery.manager.core.conflicts import (
    PREEMPTIONS_MAX,
    QUEUE_MAX,
    DemandOutcome,
    History,
    Postponed,
    Resolution,
    resolve,
)
from robotkube.delivery.tasks.core.task_description import (
    CONFLICT_POLICIES,
    INSUFFICIENT_RESOURCES,
    OFFLOAD,
    POSTPONE,
    PREEMPT,
    PREEMPTED,
    QUEUE_FULL,
    QUEUE_TOO_LONG,
    REJECT,
    SETTLED_REASONS,
    TaskDescription,
)

SECOND = 1_000_000_000
NOW = 1_795_250_000 * SECOND


def task(name: str, slots: int = 1, created: int = 0, **changes: Any) -> TaskDescription:
    at = f"2026-11-21T10:{created // 60:02d}:{created % 60:02d}Z"
    event = ("cloud-0/detector", "near", f"event-{name}", "a" * 32, "")
    return replace(TaskDescription("cloud-0", name, 1, at, *event, "app", {"slots": slots}), **changes)


def demand(description: TaskDescription) -> Demand:
    return Demand(description.key, description.application, description.parameters, task=description)


@dataclass
class Slots:
    """So many slots at the edge, and elsewhere by role; `asked` counts compositions."""

    edge: int = 2
    elsewhere: Mapping[str, int] = field(default_factory=dict)
    asked: int = 0

    def compose(self, demands: Sequence[Demand]) -> Composition:
        self.asked += 1
        free = {"edge": self.edge, **self.elsewhere}
        outcomes: dict[str, Met | Refused] = {}
        for one in demands:
            wanted = one.parameters.get("slots", 0)
            place = next((role for role in one.roles or ("edge",) if free.get(role, 0) >= wanted), "")
            if place:
                free[place] -= wanted
                outcomes[one.key] = Met((f"{place}/{one.key.split('/')[-1]}",), (place,))
            else:
                outcomes[one.key] = Refused(INSUFFICIENT_RESOURCES, f"{wanted} slots wanted")
        return Composition({}, outcomes)

    def resolve(self, *tasks: TaskDescription, now: int = NOW, **history: Any) -> Resolution:
        return resolve([demand(t) for t in tasks], self.compose, History(**history), now)


def places(resolution: Resolution) -> dict[str, str]:
    """The place of each demand, or why it has none."""
    return {key.split("/")[1]: _word(outcome) for key, outcome in resolution.outcomes.items()}


def _word(outcome: DemandOutcome) -> str:
    return (
        outcome.choices[-1]
        if isinstance(outcome, Met)
        else "Postponed"
        if isinstance(outcome, Postponed)
        else outcome.reason
    )


def keys(*names: str) -> frozenset[str]:
    return frozenset(f"cloud-0/{name}" for name in names)


def test_without_conflicts_everything_is_met_by_one_composition() -> None:
    slots = Slots(2)
    assert places(slots.resolve(task("a"), task("b", conflict_policy=PREEMPT))) == {"a": "edge", "b": "edge"}
    assert slots.asked == 1


def test_new_demands_are_placed_by_priority_then_age() -> None:
    resolution = Slots(2).resolve(task("old"), task("new", created=5), task("urgent", created=9, priority=500))
    assert places(resolution) == {"urgent": "edge", "old": "edge", "new": INSUFFICIENT_RESOURCES}


def test_what_stands_on_main_keeps_its_place() -> None:
    resolution = Slots(1).resolve(task("low", priority=0), task("urgent", priority=1000), answered=keys("low"))
    assert places(resolution) == {"low": "edge", "urgent": INSUFFICIENT_RESOURCES}


def test_the_initial_configuration_comes_first_and_never_gives_way() -> None:
    initial = Demand("initial/bridge/vehicle-00", "bridge", {"slots": 1}, agent="vehicle-00")
    urgent = demand(task("urgent", priority=1000, conflict_policy=PREEMPT))
    resolution = resolve([urgent, initial], Slots(1).compose, History(), NOW)
    assert isinstance(resolution.outcomes["initial/bridge/vehicle-00"], Met)
    assert resolution.outcomes["cloud-0/urgent"] == Refused(INSUFFICIENT_RESOURCES, "1 slots wanted")


def test_a_refusal_of_a_conflict_stands_though_there_is_room_now() -> None:
    settled = {"cloud-0/a": Refused(INSUFFICIENT_RESOURCES, "no slot")}
    resolution = Slots(2).resolve(task("a"), settled=settled)
    assert resolution.outcomes == settled
    assert isinstance(Slots(2).resolve(task("a")).outcomes["cloud-0/a"], Met)


def test_offload_runs_elsewhere_and_says_why() -> None:
    resolution = Slots(1, {"cloud": 1}).resolve(task("a", priority=200), task("b", conflict_policy=OFFLOAD))
    assert places(resolution) == {"a": "edge", "b": "cloud"}
    outcome = resolution.outcomes["cloud-0/b"]
    assert isinstance(outcome, Met)
    assert outcome.choices[0] == "offloaded to cloud: InsufficientResources: 1 slots wanted"
    assert resolution.offloaded == keys("b")


def test_offload_without_a_place_elsewhere_names_both_refusals() -> None:
    resolution = Slots(0).resolve(task("b", conflict_policy=OFFLOAD, offload_to=("cloud", "roadside")))
    outcome = resolution.outcomes["cloud-0/b"]
    assert isinstance(outcome, Refused)
    assert outcome.message == "1 slots wanted; on cloud, roadside instead: 1 slots wanted"


def test_what_was_offloaded_stays_there() -> None:
    resolution = Slots(5, {"cloud": 1}).resolve(
        task("b", conflict_policy=OFFLOAD), answered=keys("b"), offloaded=keys("b")
    )
    assert places(resolution) == {"b": "cloud"}
    assert resolution.offloaded == keys("b")


def test_postpone_waits_in_order_with_position_and_end() -> None:
    waiting = [task(name, created=n, conflict_policy=POSTPONE, queue_seconds_max=60) for n, name in enumerate("abc")]
    resolution = Slots(1).resolve(task("first", priority=200), *waiting)
    outcome = resolution.outcomes["cloud-0/b"]
    assert isinstance(outcome, Postponed)
    assert (outcome.position, outcome.since_ns, outcome.until_ns) == (2, NOW, NOW + 60 * SECOND)
    assert outcome.message == (
        "waits at position 2 of 3 until 2026-11-21T08:34:20Z: InsufficientResources: 1 slots wanted"
    )
    assert resolution.next_due_ns == NOW + 60 * SECOND


def test_who_waited_longer_comes_before_who_is_a_little_more_urgent() -> None:
    since = {"cloud-0/a": NOW - 60 * SECOND}
    resolution = Slots(1).resolve(
        task("a", conflict_policy=POSTPONE), task("b", priority=150, conflict_policy=POSTPONE), waiting=since
    )
    assert places(resolution) == {"a": "edge", "b": "Postponed"}


def test_at_its_end_a_waiting_demand_runs_or_is_refused() -> None:
    late = task("a", conflict_policy=POSTPONE, queue_seconds_max=60)
    since = {"cloud-0/a": NOW - 60 * SECOND}
    refused = Slots(0).resolve(late, waiting=since).outcomes["cloud-0/a"]
    assert refused == Refused(QUEUE_TOO_LONG, "waited for 60 s: InsufficientResources: 1 slots wanted")
    assert places(Slots(1).resolve(late, waiting=since)) == {"a": "edge"}


def test_the_queue_has_an_end_and_who_waits_keeps_its_place() -> None:
    line = [task(f"a{n:03d}", created=n, conflict_policy=POSTPONE) for n in range(QUEUE_MAX)]
    since = {t.key: NOW - SECOND for t in line}
    resolution = Slots(0).resolve(*line, task("late", priority=1000, conflict_policy=POSTPONE), waiting=since)
    assert places(resolution)["late"] == QUEUE_FULL
    assert sum(isinstance(o, Postponed) for o in resolution.outcomes.values()) == QUEUE_MAX


def test_preempt_takes_the_fewest_and_lowest() -> None:
    standing = [task("small", priority=1), task("low", 3, priority=2), task("high", 3, priority=90)]
    resolution = Slots(7).resolve(
        *standing, task("urgent", 3, priority=100, conflict_policy=PREEMPT), answered=keys("small", "low", "high")
    )
    assert places(resolution) == {"small": "edge", "low": PREEMPTED, "high": "edge", "urgent": "edge"}
    assert resolution.outcomes["cloud-0/low"] == Refused(PREEMPTED, "gave way to cloud-0/urgent of priority 100")
    outcome = resolution.outcomes["cloud-0/urgent"]
    assert isinstance(outcome, Met)
    assert outcome.choices[0] == "cloud-0/low gave way to it"


def test_nobody_gives_way_to_an_equal_or_for_nothing() -> None:
    slots = Slots(2)
    equal = task("equal", 2, priority=100, conflict_policy=PREEMPT)
    assert places(slots.resolve(task("a", 2), equal, answered=keys("a")))["equal"] == INSUFFICIENT_RESOURCES
    huge = task("huge", 9, priority=500, conflict_policy=PREEMPT)
    assert places(slots.resolve(task("a", 2), huge, answered=keys("a"))) == {
        "a": "edge",
        "huge": INSUFFICIENT_RESOURCES,
    }


@pytest.mark.parametrize(("policy", "becomes"), [(POSTPONE, "Postponed"), (OFFLOAD, "cloud"), (REJECT, PREEMPTED)])
def test_who_gives_way_fares_as_its_own_policy_says(policy: str, becomes: str) -> None:
    low = task("low", priority=1, conflict_policy=policy)
    resolution = Slots(1, {"cloud": 1}).resolve(low, task("urgent", conflict_policy=PREEMPT), answered=keys("low"))
    assert places(resolution) == {"low": becomes, "urgent": "edge"}
    outcome = resolution.outcomes[low.key]
    text = outcome.choices[0] if isinstance(outcome, Met) else outcome.message
    assert "gave way to cloud-0/urgent of priority 100" in text


def test_too_many_pre_emptions_at_once_are_left_for_the_next_step() -> None:
    standing = [task(f"low{n:02d}", priority=1) for n in range(15)]
    preemptors = [task(f"urgent{n:02d}", priority=500, created=n, conflict_policy=PREEMPT) for n in range(15)]
    resolution = Slots(15).resolve(*standing, *preemptors, answered=frozenset(t.key for t in standing))
    assert resolution.undecided == {t.key for t in preemptors[PREEMPTIONS_MAX:]}
    assert not resolution.undecided & set(resolution.outcomes)
    assert sum(word == PREEMPTED for word in places(resolution).values()) == PREEMPTIONS_MAX


def test_a_pre_emption_among_hundreds_needs_few_compositions() -> None:
    slots = Slots(200)
    standing = [task(f"low{n:03d}", priority=n // 2) for n in range(200)]
    resolution = slots.resolve(
        *standing, task("urgent", 2, priority=500, conflict_policy=PREEMPT), answered=frozenset(t.key for t in standing)
    )
    assert {k for k, word in places(resolution).items() if word == PREEMPTED} == {"low000", "low001"}
    assert slots.asked < 40


DEMANDS = st.lists(
    st.builds(
        lambda slots, priority, policy, created, queue: (slots, priority, policy, created, queue),
        st.integers(1, 4),
        st.integers(0, 5),
        st.sampled_from(CONFLICT_POLICIES),
        st.integers(0, 3),
        st.integers(1, 30),
    ),
    max_size=12,
)


def made(drawn: Iterable[tuple[int, int, str, int, int]]) -> list[TaskDescription]:
    return [
        task(f"t{n:02d}", slots, created, priority=priority, conflict_policy=policy, queue_seconds_max=queue)
        for n, (slots, priority, policy, created, queue) in enumerate(drawn)
    ]


@given(DEMANDS, st.integers(0, 8), st.integers(0, 4), st.randoms(use_true_random=False))
def test_the_answer_does_not_depend_on_the_order_and_takes_nobody_down_without_need(
    drawn: list[tuple[int, int, str, int, int]], edge: int, cloud: int, chance: Any
) -> None:
    tasks = made(drawn)
    slots = Slots(edge, {"cloud": cloud})
    resolution = slots.resolve(*tasks)
    chance.shuffle(tasks)
    assert slots.resolve(*tasks) == resolution
    assert set(resolution.outcomes) | resolution.undecided == {t.key for t in tasks}
    by_key = {t.key: t for t in tasks}
    used = [t.parameters["slots"] for t in tasks if _word(resolution.outcomes[t.key]) == "edge"]
    assert sum(used) <= edge
    for key, outcome in resolution.outcomes.items():
        if isinstance(outcome, Refused) and outcome.reason == PREEMPTED:
            preemptor = by_key[outcome.message.split()[3]]
            assert preemptor.priority > by_key[key].priority
            assert isinstance(resolution.outcomes[preemptor.key], Met)


class Days:
    """A manager's life: resolutions one after the other, each with what the last one decided; main follows at once."""

    def __init__(self, slots: Slots) -> None:
        self.slots, self.now = slots, NOW
        self.tasks: dict[str, TaskDescription] = {}
        self.waiting: dict[str, int] = {}
        self.settled: dict[str, Refused] = {}
        self.answered: frozenset[str] = frozenset()
        self.offloaded: frozenset[str] = frozenset()

    def step(self) -> Resolution:
        history = History(self.waiting, self.settled, self.offloaded & set(self.tasks), self.answered & set(self.tasks))
        resolution = resolve([demand(t) for t in self.tasks.values()], self.slots.compose, history, self.now)
        outcomes = resolution.outcomes
        self.waiting = {k: o.since_ns for k, o in outcomes.items() if isinstance(o, Postponed)}
        self.settled = {k: o for k, o in outcomes.items() if isinstance(o, Refused) and o.reason in SETTLED_REASONS}
        self.answered = frozenset(k for k, o in outcomes.items() if isinstance(o, Met))
        self.offloaded = resolution.offloaded
        return resolution


@given(
    st.lists(st.tuples(DEMANDS.map(lambda template: template[:3]), st.integers(0, 5), st.integers(0, 3)), max_size=12),
    st.integers(0, 5),
)
def test_every_postponed_task_runs_or_is_refused_within_its_bound(
    steps: list[tuple[list[tuple[int, int, str, int, int]], int, int]], edge: int
) -> None:
    """New demands come all the time, of any priority; the manager decides when it is due and when something comes."""
    days = Days(Slots(edge))
    due: int | None = None
    for number, (drawn, pause, gone) in enumerate(steps):
        for template in made(drawn):
            one = replace(template, name=f"s{number:02d}-{template.name}")
            days.tasks[one.key] = one
        for key in sorted(days.answered)[:gone]:
            days.tasks.pop(key, None)
        end = days.now + pause * SECOND
        while due is not None and due <= end:
            days.now, due = due, days.step().next_due_ns
        days.now = end
        due = days.step().next_due_ns
        for key, since in days.waiting.items():
            assert days.now < since + days.tasks[key].queue_seconds_max * SECOND
            assert due is not None
            assert due <= since + days.tasks[key].queue_seconds_max * SECOND
    while due is not None:
        days.now, due = due, days.step().next_due_ns
    assert days.waiting == {}
    assert set(days.tasks) <= days.answered | set(days.settled)
