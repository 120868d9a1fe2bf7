"""Tasks as entries of the ledger: which stand, which have expired, what their statuses remember."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.delivery.manager.core.composition.composer import Refused
from robotkube.delivery.manager.core.standing_demands import (
    PastDecision,
    StandingDemands,
    TaskReader,
    demands_at,
    past_decision,
)
from robotkube.delivery.tasks.core.task_description import LEASE_EXPIRED, SETTLED_REASONS
from robotkube.foundation.documents.core.times import time_ns
from robotkube.foundation.kubernetes.core.annotations import RENEWED_ANNOTATION

CREATED = "2026-11-21T10:00:00Z"
BEGIN = time_ns(CREATED)
SECOND = 1_000_000_000


def document(name: str = "meeting", annotations: dict[str, str] | None = None, **spec: Any) -> dict[str, Any]:
    event = {"rule": "near", "id": f"event-{name}", "trace": "a" * 32, "time": CREATED}
    full = {"requester": "cloud-0/detector", "event": event, "application": "recording", "parameters": {}}
    metadata = {"namespace": "cloud-0", "name": name, "generation": 1, "creationTimestamp": CREATED, "uid": name}
    return {"metadata": {**metadata, "annotations": annotations or {}}, "spec": {**full, **spec}}


def demands(*documents: dict[str, Any], after_seconds: float = 0) -> StandingDemands:
    return demands_at(TaskReader().read(documents), BEGIN + int(after_seconds * SECOND))


def test_a_task_without_a_lease_stands_until_it_is_deleted() -> None:
    task = document()
    standing = demands(task, after_seconds=10**8)
    assert (list(standing.live), standing.next_due_ns) == (["cloud-0/meeting"], None)
    task["metadata"]["deletionTimestamp"] = CREATED
    assert demands(task) == StandingDemands()


def test_what_was_asked_is_the_same_object_until_the_document_changes() -> None:
    reader = TaskReader()
    task = document()
    reader.read([task])
    asked = reader.asked()["cloud-0/meeting"]
    reader.read([{**task, "status": {"phase": "new"}}])
    assert reader.asked()["cloud-0/meeting"] is asked
    assert reader.document("cloud-0/meeting")["status"] == {"phase": "new"}
    task["metadata"] = {**task["metadata"], "generation": 2}
    reader.read([task])
    assert reader.asked()["cloud-0/meeting"].stamp == (asked.stamp[0], 2)


def test_a_lease_ends_at_its_second() -> None:
    task = document(lease={"seconds": 5})
    before = demands(task, after_seconds=4.999)
    assert (list(before.live), before.next_due_ns) == (["cloud-0/meeting"], BEGIN + 5 * SECOND)
    after = demands(task, after_seconds=5)
    assert not after.live
    assert after.next_due_ns is None
    assert after.refused["cloud-0/meeting"].reason == LEASE_EXPIRED
    assert RENEWED_ANNOTATION in after.refused["cloud-0/meeting"].message


def test_a_renewal_moves_the_end_and_makes_an_expired_task_a_demand_again() -> None:
    renewed = {RENEWED_ANNOTATION: "2026-11-21T10:00:08.500000Z"}
    standing = demands(document(annotations=renewed, lease={"seconds": 5}), after_seconds=10)
    assert standing.next_due_ns == BEGIN + int(13.5 * SECOND)
    assert demands(document(lease={"seconds": 5}), after_seconds=10).live == {}


def test_a_renewal_before_the_creation_shortens_nothing() -> None:
    renewed = {RENEWED_ANNOTATION: "2026-11-21T09:00:00Z"}
    assert demands(document(annotations=renewed, lease={"seconds": 5})).next_due_ns == BEGIN + 5 * SECOND


def test_the_order_is_that_of_creation_then_of_key_whatever_the_list() -> None:
    later, first, second = document("c"), document("a"), document("b")
    later["metadata"]["creationTimestamp"] = "2026-11-21T10:00:01Z"
    first["metadata"]["creationTimestamp"] = second["metadata"]["creationTimestamp"] = CREATED
    assert list(demands(later, second, first).live) == ["cloud-0/a", "cloud-0/b", "cloud-0/c"]
    assert list(demands(first, later, second).live) == ["cloud-0/a", "cloud-0/b", "cloud-0/c"]


def test_the_same_key_twice_is_one_task_and_the_newest_counts() -> None:
    changed = document(parameters={"x": 1})
    changed["metadata"]["generation"] = 2
    [task] = demands(document(), changed).live.values()
    assert (task.generation, task.parameters) == (2, {"x": 1})


def test_a_task_is_read_again_only_when_something_changed() -> None:
    reader = TaskReader()
    task = document()
    [first] = reader.read([task]).values()
    task["status"] = {"plan": "p"}
    assert reader.read([task])["cloud-0/meeting"] is first
    task["spec"] = {**task["spec"], "priority": 5}
    assert reader.read([task])["cloud-0/meeting"] is not first


def test_what_cannot_be_read_is_refused_and_holds_nobody() -> None:
    standing = demands(document("good"), document("bad", priority="high"))
    assert list(standing.live) == ["cloud-0/good"]
    assert standing.refused["cloud-0/bad"] == Refused(
        "InvalidParameters", "task cloud-0/bad: spec.priority: must be a whole number from 0 to 1000"
    )


def test_what_is_nested_too_deeply_is_refused_every_time() -> None:
    reader = TaskReader()
    for _ in range(2):
        deep: Any = 0
        for _ in range(950):
            deep = [deep]
        refusal = reader.read([document(parameters={"x": deep})])["cloud-0/meeting"]
        assert isinstance(refusal, Refused)
        assert "nested deeper than 32" in refusal.message


def with_status(reason: str, generation: int = 1, **status: Any) -> dict[str, Any]:
    condition = {"type": "Accepted", "status": "False", "reason": reason, "message": "because"}
    return {**document(), "status": {"observedGeneration": generation, "conditions": [condition], **status}}


@pytest.mark.parametrize("reason", sorted(SETTLED_REASONS))
def test_a_settled_conflict_is_found_in_the_status(reason: str) -> None:
    assert past_decision(with_status(reason)) == PastDecision(settled=Refused(reason, "because"))
    assert past_decision(with_status(reason, generation=7)) == PastDecision()


def test_a_place_in_the_queue_and_another_place_are_found_in_the_status() -> None:
    waiting = with_status("Postponed", queue={"since": "2026-11-21T10:00:01.500000Z"})
    assert past_decision(waiting) == PastDecision(waiting_since_ns=BEGIN + int(1.5 * SECOND))
    assert past_decision(with_status("Postponed", queue={"since": "yesterday"})) == PastDecision()
    assert past_decision(with_status("NoCapableNode")) == PastDecision()
    accepted = document() | {"status": {"observedGeneration": 1, "offloaded": True}}
    assert past_decision(accepted) == PastDecision(offloaded=True)
    assert past_decision(document()) == PastDecision()
