"""What became of demands is read from main and the tasks' conditions; what encounters share, from main and the pods."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from scenarios import definition
from scenarios.runner.inputs import (
    BrokerLog,
    BrokerResult,
    Commit,
    MainState,
    PodOfRun,
    PullRequestOfRun,
    RunInputs,
    StepDone,
    TaskCondition,
    TaskLife,
)
from scenarios.runner.judging import audit, outcomes, sharing
from scenarios.runner.reporting import page, report

SECOND = 1_000_000_000
PLACE = "edge-0/object-detection-"


def told(time: int, reason: str, message: str = "edge-0 has not enough room", status: str = "False") -> TaskCondition:
    return TaskCondition(time, "Accepted", status, reason, message)


def task(name: str, *conditions: TaskCondition, deleted: int | None = 90, **spec: Any) -> TaskLife:
    return TaskLife(f"cloud-0/{name}", 1, spec, "", conditions, deleted)


def state(number: int, **seats: str) -> MainState:
    """A commit: release -> names of tasks; underscores in releases stand for what a keyword cannot hold."""
    tasks = {
        release.replace("__", "/").replace("_", "-"): tuple(f"cloud-0/{name}" for name in names.split())
        for release, names in seats.items()
    }
    return MainState(str(number), tasks)


@pytest.fixture
def scenario() -> definition.Scenario:
    return definition.load(definition.find("resource-conflict"))


@pytest.fixture
def inputs() -> RunInputs:
    """The conflict as it should go: low and ordinary first, one elsewhere, one refused, one that waited, one urgent."""
    nothing: dict[str, Any] = dict.fromkeys(
        ("stored", "recordings", "edges", "plans", "pull_requests", "commits", "pods"), ()
    )
    fine = told(2, "Accepted", "offloaded to cloud: InsufficientResources: edge-0 has not enough room", "True")
    return RunInputs(
        run="r", provider="embedded", started=0, ended=100, ledgers={}, input_before=None, input_after=None,
        broker=None, releases_before={"a/b": "1"}, releases_after={"a/b": "1"},
        tasks=(
            task("low", told(1, "Accepted", "", "True"), told(30, "Preempted", "gave way to cloud-0/urgent")),
            task("ordinary", told(1, "Accepted", "", "True")),
            task("elsewhere", fine, conflictPolicy="Offload"),
            task("unlucky", told(3, "InsufficientResources")),
            task("patient", told(4, "Postponed"), told(40, "Accepted", "", "True")),
            task("urgent", told(5, "Accepted", "", "True")),
        ),
        history=(
            state(0),
            state(1, edge_0__a="low", edge_0__b="ordinary", edge_0__mqtt_bridge="low ordinary"),
            state(2, edge_0__a="low", edge_0__b="ordinary", cloud_0__c="elsewhere"),
            state(3, edge_0__f="urgent", edge_0__b="ordinary", cloud_0__c="elsewhere"),
            state(4, edge_0__f="urgent", edge_0__e="patient", cloud_0__c="elsewhere"),
            state(5),
        ),
        steps=(StepDone("one", "waits", 1, 2), StepDone("two", "submits", 3, 4)),
        **nothing,
    )  # fmt: skip


def names(found: tuple[TaskLife, ...]) -> list[str]:
    return [one.key.partition("/")[2] for one in found]


def test_each_demand_is_known_by_what_became_of_it(scenario: definition.Scenario, inputs: RunInputs) -> None:
    assert names(outcomes.offloaded(scenario, inputs)) == ["elsewhere"]
    assert names(outcomes.postponed(inputs)) == ["patient"]
    assert names(outcomes.refused(inputs)) == ["unlucky"]
    assert names(outcomes.preempted(inputs)) == ["low"]
    assert outcomes.reasons_named(scenario, inputs) == 1
    assert outcomes.steps_reached(inputs) == 1


def without(inputs: RunInputs, *names: str) -> RunInputs:
    gone = {f"cloud-0/{name}" for name in names}
    states = (
        replace(one, tasks={release: tuple(t for t in tasks if t not in gone) for release, tasks in one.tasks.items()})
        for one in inputs.history
    )
    return replace(inputs, history=tuple(states))


def test_words_without_deeds_count_for_nothing(scenario: definition.Scenario, inputs: RunInputs) -> None:
    """Conditions alone do not do: main must show it."""
    bare = without(inputs, "low", "elsewhere", "patient")
    assert outcomes.offloaded(scenario, bare) == outcomes.postponed(bare) == outcomes.preempted(bare) == ()


def test_deeds_without_words_count_for_nothing(scenario: definition.Scenario, inputs: RunInputs) -> None:
    silent = replace(inputs, tasks=tuple(replace(one, conditions=()) for one in inputs.tasks))
    assert outcomes.postponed(silent) == outcomes.refused(silent) == outcomes.preempted(silent) == ()
    assert outcomes.reasons_named(scenario, silent) == 0  # the offloaded one is told nothing


def test_who_ran_where_it_had_asked_for_was_not_offloaded(scenario: definition.Scenario, inputs: RunInputs) -> None:
    stayed = replace(inputs, history=(*inputs.history, state(6, edge_0__c="elsewhere")))
    assert outcomes.offloaded(scenario, stayed) == ()


def test_who_was_refused_and_ran_later_was_not_refused(inputs: RunInputs) -> None:
    assert outcomes.refused(replace(inputs, history=(*inputs.history, state(6, edge_0__d="unlucky")))) == ()


def test_who_was_withdrawn_was_not_preempted(inputs: RunInputs) -> None:
    early = tuple(replace(one, deleted=20) for one in inputs.tasks)
    assert outcomes.preempted(replace(inputs, tasks=early)) == ()


def test_a_step_that_was_not_seen_lowers_the_share(inputs: RunInputs) -> None:
    assert outcomes.steps_reached(replace(inputs, steps=(*inputs.steps, StepDone("three", "waits", 5, None)))) == 2 / 3
    assert outcomes.steps_reached(replace(inputs, steps=())) is None


def test_a_chain_is_as_deep_as_its_longest_line(inputs: RunInputs) -> None:
    child = replace(task("child"), parent="cloud-0/low")
    grandchild = replace(task("grandchild"), parent="cloud-0/child")
    assert outcomes.chain_depth(inputs) == 1
    assert outcomes.chain_depth(replace(inputs, tasks=(*inputs.tasks, child, grandchild))) == 3
    endless = replace(task("a"), parent="cloud-0/a")
    assert outcomes.chain_depth(replace(inputs, tasks=(endless,))) == outcomes.PARENTS_MAX
    assert outcomes.chain_depth(replace(inputs, tasks=())) is None


def seen(inputs: RunInputs, *times: int, gaps: int = 0) -> RunInputs:
    texts = [json.dumps({"stamp": 1, "tracks": [{"id": 1, "x": 0}]}), json.dumps({"tracks": []}), "no JSON"]
    results = tuple(BrokerResult(time, "t", texts[n % len(texts)]) for n, time in enumerate(times))
    pod = PodOfRun("roadside-0", "object-tracking-roadside-0-x", "u", 1, 2, 3, deleted=10 * SECOND)
    log = BrokerLog(-1, 101 * SECOND, gaps, (), results)
    return replace(inputs, broker=log, pods=(pod,), ended=100 * SECOND)


def test_results_are_counted_while_the_observer_was_there(inputs: RunInputs) -> None:
    assert outcomes.results(seen(inputs, 1, 2, 3)) == 3
    assert outcomes.results(seen(inputs, 1, gaps=1)) is None
    assert outcomes.results(inputs) is None
    assert outcomes.results_after_removal(seen(inputs, 1, 11 * SECOND)) == 0
    assert outcomes.results_after_removal(seen(inputs, 1, 13 * SECOND)) == 1
    assert outcomes.results_after_removal(seen(inputs)) is None
    assert outcomes.track_identities(seen(inputs, 1, 2, 3, 4)) == 1
    assert outcomes.track_identities(inputs) is None


def test_the_report_of_a_story_with_steps_tells_steps_and_tasks(
    scenario: definition.Scenario, inputs: RunInputs
) -> None:
    done = report.report(scenario, inputs)
    rows = {row.name: row for row in done.table}
    assert list(rows) == list(scenario.expectations)
    assert {name for name, row in rows.items() if not row.passed} == {"audit_complete", "releases_had_evidence"}
    assert [step["step"] for step in done.document["steps"]] == ["one", "two"]
    assert done.document["tasks"][0]["conditions"][1]["reason"] == "Preempted"
    html = page.page(done)
    assert "gave way to cloud-0/urgent" in html
    assert "<h2>Steps</h2>" in html
    assert any("story begins" in moment.text for moment in done.moments)


# what encounters share ------------------------------------------------------------------------------------------------


@pytest.fixture
def overlap(run: Any) -> Any:
    """The healthy run's two encounters as two that overlap in vehicle-01."""
    met = list(report.encounters(run.scenario, run.inputs()))
    later = replace(met[1].start, agents=("vehicle-01", "vehicle-02"), time=met[0].start.time + 5 * SECOND)
    scenario = replace(run.scenario, parameters=replace(run.scenario.parameters, lidar_vehicles=3))
    met[1] = replace(met[1], start=later)
    return run.inputs(), [replace(one, scenario=scenario) for one in met]


def uplink(*named: str) -> tuple[MainState, ...]:
    """Main, commit by commit, with the tasks that vehicle-01's uplink names."""
    return tuple(
        MainState(str(number), {"vehicle-01/mqtt-bridge": tuple(f"cloud-0/task-{one}" for one in names.split())})
        for number, names in enumerate(named)
    )


def test_one_uplink_serves_both_until_the_second_ends(overlap: Any) -> None:
    inputs, met = overlap
    assert [agent for _, _, agent in sharing.overlapping(met)] == ["vehicle-01"]
    fine = replace(inputs, history=uplink("", "0", "0 1", "1", ""))
    assert sharing.demands_max(fine, met) == 2
    assert sharing.kept(fine, met) is True
    bridge = PodOfRun("vehicle-01", "mqtt-bridge-1", "a", 1)
    assert sharing.pods(replace(fine, pods=(bridge,)), met) == 1
    assert sharing.pods(replace(fine, pods=(bridge, replace(bridge, uid="b"))), met) == 2


@pytest.mark.parametrize(
    "named",
    [("", "0", "1", ""), ("", "0", "0 1", "", "1", ""), ("", "0", "0 1", "0", ""), ("",), ("0 1", "0")],
    ids=["never both", "interrupted", "the second first", "never", "the second ends first"],
)
def test_an_uplink_that_was_not_kept_is_seen(overlap: Any, named: tuple[str, ...]) -> None:
    inputs, met = overlap
    assert sharing.kept(replace(inputs, history=uplink(*named)), met) is False


def test_without_an_overlap_nothing_is_shared(run: Any) -> None:
    inputs = run.inputs()
    met = report.encounters(run.scenario, inputs)
    assert sharing.kept(inputs, met) is None
    assert sharing.demands_max(inputs, met) is None
    assert sharing.pods(inputs, met) is None
    assert sharing.recordings(met) == 2
    assert sharing.pairs_recorded(met) == 1


# the audit of what is nobody's task -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("trailers", "missing"),
    [
        ({"Cause": "node", "Plan": "p", "Trace": "t", "Chart": "c", "Evidence": "e"}, ()),
        ({"Cause": "update", "Plan": "p", "Trace": "t", "Chart": "c"}, ("RobotKube-Evidence",)),
        ({"Cause": "repair", "Plan": "p", "Trace": "t", "Reverts": "abc"}, ()),
        ({"Cause": "repair", "Plan": "p", "Trace": "t"}, ("RobotKube-Reverts",)),
        ({"Plan": "p", "Trace": "t", "Chart": "c", "Evidence": "e"}, ("RobotKube-Task", "RobotKube-Event")),
    ],
)
def test_commits_without_a_task_say_their_cause(trailers: dict[str, str], missing: tuple[str, ...]) -> None:
    several = {name: (value,) for name, value in trailers.items()}
    commit = Commit("a" * 40, ("b" * 40,), "manager", "deploy", 1, several, ("releases/a/b.yaml",))
    entry = audit.entry(commit, PullRequestOfRun(1, "deploy", True, commit.sha))
    assert entry.missing[: len(missing)] == missing
    assert bool(entry.missing) == bool(missing)
