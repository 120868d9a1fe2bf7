"""Composing again from what is known gives the same answer as composing from scratch, whatever happened in between."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import pytest

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.composer import Composition, Demand, Memo, Met, compose
from robotkube.delivery.manager.core.composition.inputs import Inputs
from robotkube.delivery.manager.core.composition.memo import KEPT_MAX, PREFIXES_BETWEEN_MAX, Recent
from robotkube.delivery.manager.core.placement.capacity import Resources
from robotkube.delivery.manager.core.placement.placement import Fleet, NodeState, fleet
from robotkube.delivery.tasks.core.task_description import TaskDescription, TaskPlacement
from robotkube.errors import RefusalError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.catalogue.core.guarantees import GuaranteeRequirement
from robotkube.testing.synthetic import Synthetic, demands, synthetic
from tests.stages.delivery.manager.placement import (
    NODES,
    ONE,
    PLAIN,
    application,
    catalogue,
    chart,
    demand,
    inputs,
    places,
    task,
)
from tests.stages.examples import EXAMPLES

RENDER = Jinja2Templates().render
SMALL = synthetic(RENDER, validate, charts=7, versions=3, nodes=24, task_count=6)
STEPS = 25
SEEDS = range(EXAMPLES // 10)


@dataclass
class History:
    """Inputs of composition to which random things happen."""

    chance: random.Random
    tasks: dict[str, TaskDescription] = field(default_factory=lambda: dict(SMALL.tasks))
    nodes: dict[str, NodeState] = field(default_factory=lambda: {n.name: n for n in SMALL.nodes})
    present: Mapping[str, Release] = field(default_factory=lambda: dict(SMALL.tree.releases))
    others: Mapping[str, Release] = field(default_factory=dict)
    pins: dict[str, tuple[str, str]] = field(default_factory=dict)
    withheld: dict[tuple[str, str], str] = field(default_factory=dict)
    now_ns: int = 0
    made: int = 0
    machines: Fleet = field(default_factory=lambda: fleet(SMALL.agents, SMALL.nodes))

    def inputs(self) -> Inputs:
        machines = fleet(SMALL.agents, list(self.nodes.values()), self.now_ns)
        self.machines = self.machines if self.machines == machines else machines  # one object as long as it is the same
        composed = replace(SMALL.inputs(RENDER, validate, self.present), fleet=self.machines)
        return replace(composed, others=self.others, pins=dict(self.pins), withheld=dict(self.withheld))

    def demands(self) -> list[Demand]:
        return [replace(d, roles=("cloud",)) if d.key.endswith("3") else d for d in demands(list(self.tasks.values()))]

    def happen(self, desired: Composition) -> None:
        act = self.chance.choice(
            [self.ask, self.ask, self.ask, self.withdraw, self.change, self.node, self.node, self.pin, self.hand_over]
        )
        if self.chance.random() < 0.4:
            self.present = desired.releases  # main has it now
        act()
        self.now_ns += 10_000_000_000

    def ask(self) -> None:
        self.made += 1
        task = SMALL.new_task(self.made)
        near = self.chance.choice([*self.tasks, "nobody/nothing"]) if self.tasks else "nobody/nothing"
        placement = self.chance.choice(
            [
                TaskPlacement(),
                TaskPlacement(),
                TaskPlacement(anti_affinity=(near, "d00-x")),
                TaskPlacement(roles=("roadside",)),
            ]
        )
        wanted = self.chance.choice([(), (), (GuaranteeRequirement("delay", "atMost", 101, "ms"),)])
        self.tasks[task.key] = replace(task, placement=placement, requirements=wanted)

    def withdraw(self) -> None:
        if self.tasks:
            self.tasks.pop(self.chance.choice(list(self.tasks)))

    def change(self) -> None:
        if self.tasks:
            key = self.chance.choice(list(self.tasks))
            other = SMALL.new_task(self.chance.randrange(12))
            self.tasks[key] = replace(
                self.tasks[key], application=other.application, parameters=other.parameters, generation=self.made
            )

    def node(self) -> None:
        node = self.chance.choice(SMALL.nodes)
        state = self.chance.choice(
            [
                node,
                replace(node, cordoned=True),
                replace(node, ready=False, not_ready_since=self.now_ns),
                replace(node, ready=False, not_ready_since=0),
                replace(node, allocatable=Resources(100, 2**28)),
                replace(node, platform="linux/riscv64"),
                None,
            ]
        )
        self.nodes.pop(node.name, None)
        if state is not None:
            self.nodes[node.name] = state

    def pin(self) -> None:
        chart = self.chance.choice([c for versions in SMALL.catalogue.charts.values() for c in versions])
        if self.chance.random() < 0.5 and self.present:
            self.pins[self.chance.choice(sorted(r.key for r in self.present.values()))] = (chart.chart, chart.version)
        else:
            self.withheld = {} if self.withheld else {(chart.chart, chart.version): "withheld"}

    def hand_over(self) -> None:
        paths = sorted(self.present)
        changed = frozenset(self.chance.sample(paths, len(paths) // 10))
        self.others = {path: self.present[path] for path in changed}
        self.present = {path: release for path, release in self.present.items() if path not in changed}


@dataclass(frozen=True)
class Step:
    """What is asked for at one step of a history, and what composing it from scratch gives."""

    asked: list[Demand]
    given: Inputs
    composition: Composition


@cache
def steps(seed: int) -> tuple[Step, ...]:
    """The steps of one history, composed from scratch; after some steps the same inputs with fewer demands, as they are
    tried to settle conflicts."""
    history = History(random.Random(seed))  # noqa: S311 - a case is named by its number
    made = []
    for _ in range(STEPS):
        asked = history.demands()
        given = history.inputs()
        composition = compose(asked, given)
        made.append(Step(asked, given, composition))
        if history.chance.random() < 0.3 and asked:
            trial = [d for d in asked if history.chance.random() < 0.8]
            made.append(Step(trial, given, compose(trial, given)))
        history.happen(composition)
    return tuple(made)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kept_max", [KEPT_MAX, 3])
def test_what_is_remembered_changes_nothing(seed: int, kept_max: int) -> None:
    memo = Memo(kept_max)
    for step in steps(seed):
        assert compose(step.asked, step.given, memo) == step.composition


def test_histories_meet_and_refuse_for_many_reasons() -> None:
    outcomes = [outcome for seed in SEEDS for step in steps(seed) for outcome in step.composition.outcomes.values()]
    reasons = {"Met" if isinstance(outcome, Met) else outcome.reason for outcome in outcomes}
    assert reasons >= {"Met", "NoCapableNode", "GuaranteeNotMet"}


def sizes(memo: Memo) -> list[int]:
    return [
        len(kept) for owner in (memo, memo.index(SMALL.inputs(RENDER, validate)).selector) for kept in tables(owner)
    ]


def tables(owner: object) -> list[Recent[Any, Any]]:
    return [value for value in vars(owner).values() if isinstance(value, Recent)]


def test_a_memo_keeps_as_much_as_it_may() -> None:
    kept: dict[int, list[int]] = {}
    for kept_max in (0, 3, KEPT_MAX):
        memo = Memo(kept_max)
        compose(demands(list(SMALL.tasks.values())), SMALL.inputs(RENDER, validate), memo)
        kept[kept_max] = sizes(memo)
    assert set(kept[0]) == {0}
    assert max(kept[3]) == 3
    assert max(kept[KEPT_MAX]) > 3


def test_states_of_prefixes_are_bounded() -> None:
    memo = Memo()
    asked = demands(list(SMALL.tasks.values()))
    for number in range(12):
        asked += demands([SMALL.new_task(number)])
        compose(asked, SMALL.inputs(RENDER, validate), memo)
    assert memo.prefixes == PREFIXES_BETWEEN_MAX


def test_values_of_a_release_are_checked_again_when_they_have_changed() -> None:
    schema = {"type": "object", "properties": {"x": {"type": "integer"}}}
    selector = Memo().index(inputs(schema=lambda chart, version: schema)).selector
    worker = selector.catalogue.charts["worker"][0]
    selector.check_values(worker, {"x": 1}, "roadside-0/a")
    selector.check_values(worker, {"x": 1}, "roadside-0/a")
    with pytest.raises(RefusalError, match="values"):
        selector.check_values(worker, {"x": "one"}, "roadside-0/a")


def test_composing_the_same_again_expands_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    memo = Memo()
    asked = demands(list(SMALL.tasks.values()))
    inputs = SMALL.inputs(RENDER, validate)
    composed = compose(asked, inputs, memo)
    monkeypatch.setattr("robotkube.delivery.manager.core.composition.memo.expand", None)
    assert compose(asked, inputs, memo) == composed
    assert compose(asked, replace(inputs, present={**composed.releases}), memo).releases == composed.releases


def known(asked: list[Demand], given: Inputs) -> Memo:
    """A memo that knows these demands in this fleet, where they run."""
    memo = Memo()
    for number in range(2):  # main moves in between
        compose(asked, replace(given, pins={"ops/other": ("worker", f"0.{number}.0")}), memo)
    return memo


def on_roadside_0(asked: list[Demand], offered: Catalogue = PLAIN) -> dict[str, Release]:
    """The releases of demands that were made one by one, while there was no other place."""
    alone = inputs(offered, nodes=NODES[:1])
    return {path: one for each in asked for path, one in compose([each], alone).releases.items()}


def test_what_stays_is_not_placed_again_when_main_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = [demand(task("t0")), demand(task("t1"))]
    given = inputs(present=on_roadside_0(asked))
    memo = known(asked, given)
    composed = compose(asked, given)
    monkeypatch.setattr("robotkube.delivery.manager.core.composition.assignments.place", None)
    assert compose(asked, given, memo) == composed


def test_what_stays_goes_where_there_is_room_when_others_come_first() -> None:
    asked = [demand(task(name)) for name in ("first", "second", "third")]
    given = inputs(present=on_roadside_0(asked))
    composed = compose(asked, given)
    assert places(composed) == {"a-first": "roadside-0", "a-second": "roadside-0", "a-third": "roadside-1"}
    assert compose(asked, given, known(asked[2:], given)) == composed


def test_what_stays_asks_for_nothing_more_when_another_demand_plans_it() -> None:
    offered = catalogue(application({**ONE, "release": "shared"}), application(ONE, name="own"))
    asked = [demand(task("p")), demand(task("q")), demand(task("r", application="own"))]
    given = inputs(offered, present=compose(asked, inputs(offered, nodes=NODES[:1])).releases)
    composed = compose(asked, given)
    assert places(composed) == {"shared": "roadside-0", "a-r": "roadside-0"}
    assert compose(asked, given, known(asked, given)) == composed


@pytest.mark.parametrize("version", ["0.2.0", "0.1.0"])
def test_what_has_come_to_main_keeps_the_version_that_main_has(version: str) -> None:
    memo = Memo()
    asked = [demand(task())]
    given = inputs(catalogue(application(ONE), chart(version="0.2.0")))
    composed = compose(asked, given, memo)
    key = next(release.key for release in composed.releases.values())
    merged = replace(given, present=composed.releases, pins={key: ("worker", version)})
    again = compose(asked, merged, memo)
    assert again == compose(asked, merged)
    assert [release.version for release in again.releases.values()] == [version]


def test_large_inputs_are_answered_the_same_again_and_again() -> None:
    case: Synthetic = synthetic(RENDER, validate, charts=10, versions=2, nodes=60, task_count=65)
    memo = Memo()
    standing = list(case.tasks.values())
    given: Any = case.inputs(RENDER, validate)
    for number in (1, 2, 3):
        asked = demands([*standing, case.new_task(number)])
        assert compose(asked, given, memo) == compose(asked, given)
    fewer = demands([*standing[:50], *standing[51:]])
    assert compose(fewer, given, memo) == compose(fewer, given)
    assert compose([], given, memo) == Composition({}, {})
