"""Expectations of a run and what was measured of them. Pure: the same inputs give the same table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from scenarios.definition import Bound, Scenario
from scenarios.runner.inputs import STORY, RunInputs
from scenarios.runner.judging import audit, evidence, measures, naming, network, outcomes, sharing
from scenarios.runner.judging.encounters import Encounter

Value = float | int | bool | None
Measure = Callable[[Scenario, RunInputs, Sequence[Encounter]], Value]


@dataclass(frozen=True)
class Expectation:
    """One line of the table; `measured` is None when the inputs do not contain it."""

    name: str
    expected: str
    measured: Value
    passed: bool


def judge(scenario: Scenario, inputs: RunInputs, encounters: Sequence[Encounter]) -> tuple[Expectation, ...]:
    """The table: the number of encounters first where there are any, then the scenario's expectations in their
    order; a run that broke off has a line that says so. What could not be read is never measured."""
    rows = [
        _row(name, bound, None if inputs.missing & NEEDS[name] else MEASURES[name](scenario, inputs, encounters))
        for name, bound in scenario.expectations.items()
    ]
    rows += [Expectation("story_came_to_its_end", "= true", False, False)] if STORY in inputs.missing else []
    return (_seen(scenario, inputs, encounters), *rows) if scenario.records else tuple(rows)


def _seen(scenario: Scenario, inputs: RunInputs, encounters: Sequence[Encounter]) -> Expectation:
    wanted = scenario.parameters.encounters
    seen = None if "edges" in inputs.missing else len(encounters)
    return Expectation("encounters", f"= {wanted}", seen, seen == wanted)


def _row(name: str, bound: Bound, measured: Value) -> Expectation:
    return Expectation(name, str(bound), measured, bound.holds(measured))


def _payloads_equal(_: Scenario, inputs: RunInputs, encounters: Sequence[Encounter]) -> Value:
    if not inputs.ledgers or not any(encounter.readable for encounter in encounters):
        return None
    return not any(encounter.unequal for encounter in encounters)


def _transforms(_: Scenario, inputs: RunInputs, encounters: Sequence[Encounter]) -> Value:
    return not any(encounter.transforms_missing for encounter in encounters) if encounters else None


def _first_cloud(_: Scenario, inputs: RunInputs, encounters: Sequence[Encounter]) -> Value:
    return measures.worst(
        measures.latencies(encounter)["event_to_first_point_cloud_stored"] for encounter in encounters
    )


def _removed(_: Scenario, inputs: RunInputs, encounters: Sequence[Encounter]) -> Value:
    return measures.worst(measures.latencies(encounter)["stop_to_removed"] for encounter in encounters)


def _releases_equal(_: Scenario, inputs: RunInputs, encounters: Sequence[Encounter]) -> Value:
    return inputs.releases_before == inputs.releases_after if inputs.releases_before else None


MEASURES: dict[str, Measure] = {
    "pose_hz_min": lambda scenario, inputs, _: measures.pose_hz_min(scenario, inputs),
    "pose_age_p99_seconds": lambda scenario, inputs, _: measures.pose_age_seconds(scenario, inputs, 0.99),
    "point_clouds_at_broker_before_event": lambda _, inputs, met: measures.clouds_before_event(inputs, met),
    "poses_recorded_share": lambda scenario, _, met: measures.recorded_share(scenario, met, clouds=False),
    "point_clouds_recorded_share": lambda scenario, _, met: measures.recorded_share(scenario, met, clouds=True),
    "lost": lambda _, __, met: measures.recorded(met)["lost"],
    "duplicates": lambda _, __, met: measures.recorded(met)["duplicates"],
    "payloads_equal": _payloads_equal,
    "transforms_in_every_recording": _transforms,
    "event_to_first_point_cloud_seconds": _first_cloud,
    "stop_to_removed_seconds": _removed,
    "point_clouds_at_broker_after_removal": lambda _, inputs, met: measures.clouds_after_removal(inputs, met),
    "releases_after_equal_before": _releases_equal,
    "audit_complete": lambda _, inputs, __: audit.complete(inputs, audit.entries(inputs)),
    "releases_had_evidence": lambda _, inputs, __: evidence.complete(inputs),
    "poses_lost": lambda _, __, met: measures.total(one.lost_of(one.pose_topics) for one in met),
    "missing_unnamed": lambda _, __, met: naming.unnamed(met),
    "named_but_present": lambda _, __, met: naming.named_but_present(met),
    "network_as_asked": lambda _, inputs, __: network.as_asked(inputs),
    "recordings": lambda _, __, met: sharing.recordings(met),
    "pairs_recorded": lambda _, __, met: sharing.pairs_recorded(met),
    "demands_on_shared_release_max": lambda _, inputs, met: sharing.demands_max(inputs, met),
    "shared_release_kept": lambda _, inputs, met: sharing.kept(inputs, met),
    "shared_release_pods": lambda _, inputs, met: sharing.pods(inputs, met),
    "steps_reached_share": lambda _, inputs, __: outcomes.steps_reached(inputs),
    "offloaded": lambda scenario, inputs, __: len(outcomes.offloaded(scenario, inputs)),
    "postponed": lambda _, inputs, __: len(outcomes.postponed(inputs)),
    "refused": lambda _, inputs, __: len(outcomes.refused(inputs)),
    "preempted": lambda _, inputs, __: len(outcomes.preempted(inputs)),
    "reasons_named_share": lambda scenario, inputs, __: outcomes.reasons_named(scenario, inputs),
    "chain_depth": lambda _, inputs, __: outcomes.chain_depth(inputs),
    "results_at_broker": lambda _, inputs, __: outcomes.results(inputs),
    "results_at_broker_after_removal": lambda _, inputs, __: outcomes.results_after_removal(inputs),
    "track_identities": lambda _, inputs, __: outcomes.track_identities(inputs),
}

_INPUT = frozenset(["input_before", "input_after"])
_STORED = frozenset(["edges", "recordings", "stored"])
_REMOVAL = frozenset(["edges", "plans", "pods"])
_STORY = frozenset(["tasks", "history"])
_BROKER = frozenset(["broker"])
NEEDS: dict[str, frozenset[str]] = {
    "pose_hz_min": _INPUT,
    "pose_age_p99_seconds": _INPUT,
    "point_clouds_at_broker_before_event": _BROKER | {"edges"},
    "poses_recorded_share": _STORED,
    "point_clouds_recorded_share": _STORED,
    "lost": _STORED | {"ledgers"},
    "duplicates": _STORED,
    "payloads_equal": _STORED | {"ledgers"},
    "transforms_in_every_recording": _STORED,
    "event_to_first_point_cloud_seconds": _STORED,
    "stop_to_removed_seconds": _REMOVAL,
    "point_clouds_at_broker_after_removal": _REMOVAL | _BROKER,
    "releases_after_equal_before": frozenset(["releases_before", "releases_after"]),
    "audit_complete": frozenset(["commits", "pull_requests", "plans"]),
    "releases_had_evidence": frozenset(["released", "summaries"]),
    "poses_lost": _STORED | {"ledgers"},
    "missing_unnamed": _STORED | {"ledgers", "gaps"},
    "named_but_present": _STORED | {"ledgers", "gaps"},
    "network_as_asked": frozenset(["cables"]),
    "recordings": _STORED,
    "pairs_recorded": _STORED,
    "demands_on_shared_release_max": frozenset(["edges", "history"]),
    "shared_release_kept": frozenset(["edges", "history"]),
    "shared_release_pods": frozenset(["edges", "pods"]),
    "steps_reached_share": frozenset(["steps"]),
    "offloaded": _STORY,
    "postponed": _STORY,
    "refused": _STORY,
    "preempted": _STORY,
    "reasons_named_share": _STORY,
    "chain_depth": frozenset(["tasks"]),
    "results_at_broker": _BROKER,
    "results_at_broker_after_removal": _BROKER | {"pods"},
    "track_identities": _BROKER,
}
"""The fields of RunInputs that a measure is computed from, those that its encounters come from included."""
