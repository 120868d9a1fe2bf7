"""Leases, conflicts and foresight through the whole manager: main, statuses, and what restarts keep."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.manager.core.composition.composer import Met, Refused
from robotkube.delivery.manager.core.placement.capacity import Resources
from robotkube.delivery.manager.core.standing_demands import moment
from robotkube.delivery.tasks.core.refusal_outlooks import without_outlook
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS
from robotkube.foundation.kubernetes.core.annotations import RENEWED_ANNOTATION
from tests.stages.delivery.manager.manager_in_memory import START_NS, Stage

FIRST, SECOND, THIRD = ("vehicle-00", "vehicle-01"), ("vehicle-01", "vehicle-02"), ("vehicle-00", "vehicle-02")


def now(stage: Stage) -> str:
    return moment(START_NS + int(stage.seconds * 1e9))


def ask(stage: Stage, name: str, vehicles: tuple[str, ...] = FIRST, **spec: Any) -> str:
    """A task that is created now."""
    key = stage.ask(name, vehicles, **spec)
    stage.tasks.objects[key]["metadata"]["creationTimestamp"] = now(stage)
    return key


def recorders(stage: Stage) -> set[str]:
    return {release.name for release in stage.releases().values() if release.name.startswith("recorder-")}


def message(stage: Stage, key: str) -> str:
    conditions = stage.tasks.objects[key]["status"]["conditions"]
    return str(next(c["message"] for c in conditions if c["type"] == "Accepted"))


@pytest.fixture
def narrow(stage: Stage) -> Stage:
    """A cloud with room for one recorder."""
    always = sum(release.namespace == "cloud-0" for release in stage.releases().values())
    room = Resources(30 * (always + 1), 2**40)
    machines = stage.cluster.machines
    stage.cluster.machines = [replace(n, allocatable=room if n.name == "cloud-0" else None) for n in machines]
    return stage


def test_a_lease_ends_without_any_event_and_a_renewal_brings_the_demand_back(stage: Stage) -> None:
    key = ask(stage, "leased", lease={"seconds": 5})
    stage.settle()
    assert recorders(stage) == {"recorder-vehicle-00-vehicle-01"}
    stage.seconds += 4.0
    pause = stage.manager.step()
    assert pause < RESYNC_SECONDS
    stage.seconds += pause
    stage.manager.step()
    stage.manager.step()
    assert recorders(stage) == set()
    assert stage.tasks.condition(key, "Accepted") == ("False", "LeaseExpired")
    stage.tasks.annotate(key, RENEWED_ANNOTATION, now(stage))
    stage.settle()
    assert stage.tasks.condition(key, "Ready") == ("True", "Observed")
    assert "releases" in stage.tasks.objects[key]["status"]


def test_one_release_of_two_demands_stays_until_the_second_ends(stage: Stage) -> None:
    first, second = ask(stage, "one"), ask(stage, "two")
    stage.settle()
    [release] = [r for r in stage.releases().values() if r.name.startswith("recorder-")]
    assert {cause.task for cause in release.causes} == {first, second}
    stage.tasks.delete(first)
    stage.settle()
    assert recorders(stage) == {"recorder-vehicle-00-vehicle-01"}
    stage.tasks.delete(second)
    stage.settle()
    assert recorders(stage) == set()


def test_a_postponed_task_keeps_its_place_over_a_restart_and_runs_when_there_is_room(narrow: Stage) -> None:
    first = ask(narrow, "first")
    narrow.settle()
    waits = ask(narrow, "waits", SECOND, conflictPolicy="Postpone", queue={"secondsMax": 60})
    narrow.go()
    assert narrow.tasks.condition(waits, "Accepted") == ("False", "Postponed")
    assert message(narrow, waits).startswith("waits at position 1 of 1 until ")
    before = narrow.tasks.objects[waits]["status"]["queue"]
    narrow.manager = narrow.start()
    narrow.seconds += 30
    narrow.go()
    assert narrow.tasks.objects[waits]["status"]["queue"] == before
    narrow.tasks.delete(first)
    narrow.settle()
    assert narrow.tasks.condition(waits, "Ready") == ("True", "Observed")
    assert "queue" not in narrow.tasks.objects[waits]["status"]


def test_a_postponed_task_is_refused_at_its_end_also_by_a_manager_that_starts_anew(narrow: Stage) -> None:
    ask(narrow, "first")
    narrow.settle()
    waits = ask(narrow, "waits", SECOND, conflictPolicy="Postpone", queue={"secondsMax": 20})
    narrow.go()
    narrow.seconds += 25
    narrow.manager = narrow.start()
    narrow.go()
    assert narrow.tasks.condition(waits, "Accepted") == ("False", "QueueTooLong")
    assert ("cloud-0/waits", "QueueTooLong", message(narrow, waits)) in narrow.tasks.reports


def test_a_rejected_task_stays_rejected_until_it_changes(narrow: Stage) -> None:
    first = ask(narrow, "first")
    narrow.settle()
    second = ask(narrow, "second", SECOND)
    narrow.go()
    assert narrow.tasks.condition(second, "Accepted") == ("False", "InsufficientResources")
    narrow.tasks.delete(first)
    narrow.manager = narrow.start()
    narrow.settle()
    assert narrow.tasks.condition(second, "Accepted") == ("False", "InsufficientResources")
    narrow.tasks.change(second, priority=7)
    narrow.settle()
    assert narrow.tasks.condition(second, "Ready") == ("True", "Observed")


def test_the_more_urgent_task_takes_the_place_and_both_say_so(narrow: Stage) -> None:
    low = ask(narrow, "low", priority=10)
    narrow.settle()
    high = ask(narrow, "high", SECOND, priority=500, conflictPolicy="Preempt")
    narrow.settle()
    assert recorders(narrow) == {"recorder-vehicle-01-vehicle-02"}
    assert narrow.tasks.condition(high, "Ready") == ("True", "Observed")
    assert message(narrow, high).startswith("cloud-0/low gave way to it; ")
    assert narrow.tasks.condition(low, "Accepted") == ("False", "Preempted")
    assert message(narrow, low).startswith(
        "gave way to cloud-0/high of priority 500. This stands until its spec changes"
    )
    narrow.tasks.delete(high)
    narrow.settle()
    assert narrow.tasks.condition(low, "Accepted") == ("False", "Preempted")


def test_who_gave_way_to_whom_is_reported_after_the_merge_and_after_a_restart(narrow: Stage) -> None:
    low = ask(narrow, "low", priority=10)
    narrow.settle()
    high = ask(narrow, "high", SECOND, priority=500, conflictPolicy="Preempt")
    narrow.settle()
    body = narrow.forge.bodies[max(narrow.forge.pulls)]
    assert "- `cloud-0/high`: cloud-0/low gave way to it" in body
    assert "- `cloud-0/low` is refused, Preempted: gave way to cloud-0/high of priority 500" in body
    narrow.manager = narrow.start()
    narrow.settle()
    assert narrow.tasks.condition(high, "Ready") == ("True", "Observed")
    assert message(narrow, high).startswith("cloud-0/low gave way to it; ")
    assert narrow.tasks.condition(low, "Accepted") == ("False", "Preempted")
    assert without_outlook("Preempted", message(narrow, low)) == "gave way to cloud-0/high of priority 500"


def test_who_gives_way_is_not_offloaded_to_where_it_is(narrow: Stage) -> None:
    low = ask(narrow, "low", priority=10, conflictPolicy="Offload")
    narrow.settle()
    high = ask(narrow, "high", SECOND, priority=500, conflictPolicy="Preempt")
    narrow.settle()
    assert recorders(narrow) == {"recorder-vehicle-01-vehicle-02"}
    assert narrow.tasks.condition(high, "Ready") == ("True", "Observed")
    assert narrow.tasks.condition(low, "Accepted") == ("False", "Preempted")


def test_a_changed_task_takes_no_place_from_one_that_stands(narrow: Stage) -> None:
    first, same = ask(narrow, "first"), ask(narrow, "same")
    narrow.settle()
    narrow.tasks.change(first, parameters={"vehicles": list(THIRD)})
    narrow.settle()
    assert recorders(narrow) == {"recorder-vehicle-00-vehicle-01"}
    assert narrow.tasks.condition(same, "Ready") == ("True", "Observed")
    assert narrow.tasks.condition(first, "Accepted") == ("False", "InsufficientResources")


def test_foresight_tells_what_would_happen_and_does_nothing(narrow: Stage) -> None:
    low = ask(narrow, "low", priority=10)
    narrow.settle()
    document = {"metadata": {"namespace": "cloud-0", "name": "high"}, "spec": dict(narrow.tasks.objects[low]["spec"])}
    document["spec"] |= {"parameters": {"vehicles": list(SECOND)}, "priority": 500, "conflictPolicy": "Preempt"}
    tip = narrow.repository.tip
    patches = narrow.tasks.patches
    releases = narrow.releases()
    explanation = narrow.manager.planner.what_if(document)
    assert isinstance(explanation.outcome, Met)
    assert any(line.startswith("cloud-0/low is refused, Preempted: gave way") for line in explanation.lines)
    changes = {change.path: change for change in explanation.changes}
    gone = changes["releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml"]
    assert (gone.after, bool(gone.before)) == (None, True)
    assert changes["releases/cloud-0/recorder-vehicle-01-vehicle-02.yaml"].before is None
    narrow.go()
    assert (narrow.repository.tip, narrow.tasks.patches, narrow.releases()) == (tip, patches, releases)


def test_who_was_postponed_takes_the_place_of_what_would_be_withdrawn(narrow: Stage) -> None:
    key = ask(narrow, "first")
    narrow.settle()
    patient = ask(narrow, "patient", SECOND, conflictPolicy="Postpone")
    narrow.settle()
    tip = narrow.repository.tip
    explanation = narrow.manager.planner.what_if(key)
    assert explanation.outcome is None
    assert explanation.lines[0] == f"{key} would be withdrawn"
    assert any(line.startswith(f"{patient} is accepted; its releases: ") for line in explanation.lines)
    assert any(line.startswith("starts cloud-0/recorder-vehicle-01-vehicle-02 ") for line in explanation.lines)
    assert any(line.startswith("stops cloud-0/recorder-vehicle-00-vehicle-01 ") for line in explanation.lines)
    narrow.go()
    assert narrow.repository.tip == tip
    assert narrow.tasks.condition(patient, "Accepted") == ("False", "Postponed")


def test_foresight_of_what_cannot_be_read_or_changes_nothing(stage: Stage) -> None:
    key = ask(stage, "there")
    stage.settle()
    same = stage.manager.planner.what_if(stage.tasks.objects[key])
    assert same.changes == ()
    assert same.lines[-1] == "changes nothing in the deployment repository"
    wrong = {**stage.tasks.objects[key], "spec": {**stage.tasks.objects[key]["spec"], "priority": "high"}}
    outcome = stage.manager.planner.what_if(wrong).outcome
    assert isinstance(outcome, Refused)
    assert outcome.reason == "InvalidParameters"
