"""What a task says of itself: what becomes of one that was refused, and why a candidate was taken at first."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.delivery.manager.core.decision_history import ENTRIES_MAX, MESSAGE_CHARACTERS_MAX, with_decision
from robotkube.delivery.tasks.core.refusal_outlooks import outlook, with_outlook, without_outlook
from robotkube.delivery.tasks.core.task_description import REFUSAL_REASONS, SETTLED_REASONS
from tests.stages.delivery.manager.manager_in_memory import Stage


def history(stage: Stage, key: str) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = stage.tasks.objects[key]["status"]["history"]
    return entries


def accepted(stage: Stage, key: str) -> str:
    (condition,) = [c for c in stage.tasks.objects[key]["status"]["conditions"] if c["type"] == "Accepted"]
    return str(condition["message"])


def test_why_a_candidate_was_taken_stays_when_it_runs(stage: Stage) -> None:
    key = stage.ask()
    stage.settle()
    (first,) = history(stage, key)
    assert first["reason"] == "Accepted"
    assert first["runs"] == ["cloud-0/recorder-vehicle-00-vehicle-01: event-detector 0.2.3"]
    assert "event-detector 0.2.3 (verified): taken" in first["message"]
    assert "cloud-0: taken" in first["message"]
    stage.manager = stage.start()
    stage.settle()
    stage.ask("other", ("vehicle-01", "vehicle-02"))
    stage.settle()
    assert "it runs there already" in accepted(stage, key)
    assert history(stage, key) == [first]


def test_every_other_decision_is_added_with_its_time(stage: Stage) -> None:
    key = stage.ask(application="nothing")
    stage.settle()
    assert "The task stays, and is decided again when the catalogue, the nodes or other tasks change" in accepted(
        stage, key
    )
    stage.seconds += 60
    stage.tasks.change(key, application="pose-point-cloud-recording")
    stage.settle()
    stage.seconds += 60
    stage.tasks.change(key, parameters={"vehicles": ["vehicle-01", "vehicle-02"]})
    stage.settle()
    entries = history(stage, key)
    assert [(entry["generation"], entry["reason"]) for entry in entries] == [
        (1, "UnknownApplication"),
        (2, "Accepted"),
        (3, "Accepted"),
    ]
    assert [entry["runs"] for entry in entries] == [
        [],
        ["cloud-0/recorder-vehicle-00-vehicle-01: event-detector 0.2.3"],
        ["cloud-0/recorder-vehicle-01-vehicle-02: event-detector 0.2.3"],
    ]
    times = [entry["time"] for entry in entries]
    assert times == sorted(set(times))


def test_the_history_is_bounded() -> None:
    entries: list[Any] = []
    for number in range(3 * ENTRIES_MAX):
        entries = with_decision(entries, number, "Accepted", ["x"] * 1000, "m" * 100_000, "2026-11-21T10:00:00Z")
        same = with_decision(entries, number, "Accepted", ["x"] * 1000, "another message", "2026-11-21T11:00:00Z")
        assert same == entries
    assert [entry["generation"] for entry in entries] == list(range(2 * ENTRIES_MAX, 3 * ENTRIES_MAX))
    assert {len(entry["message"]) for entry in entries} == {MESSAGE_CHARACTERS_MAX}


@pytest.mark.parametrize("reason", REFUSAL_REASONS)
def test_every_refusal_says_what_becomes_of_the_task(reason: str) -> None:
    message = with_outlook(reason, "no node", 4096)
    assert without_outlook(reason, message) == "no node"
    assert len(with_outlook(reason, "x" * 10_000, 4096)) == 4096
    assert with_outlook(reason, "x" * 10_000, 4096).endswith(outlook(reason))
    assert ("stands until its spec changes" in message) == (reason in SETTLED_REASONS)
