"""Operator applications support automatic conflict resolution.

Example: If there are no compute resources left in a vehicle, an operator application is able to cancel or postpone
deployments, or resolve the conflict by other means such as offloading to a different connected agent.

Story: An edge server has room for two detections. A third runs in the cloud instead, a fourth waits, a fifth is
refused; when a place is free the one that waited runs; an urgent one has one of low priority cancelled. Git and cluster
show each, and each was told why.
"""

from __future__ import annotations

from typing import Any

from tests.stages.platform.table_one import Stage


def asked(stage: Stage, name: str, sensor: str, **more: Any) -> str:
    """A detection that shall run on an edge server."""
    placement = {"roles": ["edge"]}
    parameters = {"sensor": sensor}
    return stage.submit(
        "cloud-0", name, application="object-detection", parameters=parameters, placement=placement, **more
    )


def test_demands_are_offloaded_postponed_refused_and_cancelled(stage: Stage) -> None:
    low = asked(stage, "p10-low", "vehicle-00", priority=50)
    first, second = "edge-0/object-detection-vehicle-00", "edge-0/object-detection-vehicle-01"
    stage.await_running(first)
    ordinary = asked(stage, "p10-ordinary", "vehicle-01")
    stage.await_running(second)

    offloaded = asked(stage, "p10-offloaded", "vehicle-02", conflictPolicy="Offload")
    elsewhere = "cloud-0/object-detection-vehicle-02"
    assert stage.await_running(elsewhere)[elsewhere].node == "cloud-0"
    assert stage.releases_of(offloaded) == {elsewhere}
    assert "offloaded to cloud" in stage.condition(offloaded)["message"]

    refused = asked(stage, "p10-refused", "cloud-0")
    assert "edge-0" in stage.await_reason(refused, "InsufficientResources")["message"]
    patient = asked(stage, "p10-patient", "roadside-0", conflictPolicy="Postpone")
    waited = "edge-0/object-detection-roadside-0"
    assert "edge-0" in stage.await_reason(patient, "Postponed")["message"]
    assert stage.releases_of(refused) == stage.releases_of(patient) == set()

    stage.withdraw(ordinary)
    stage.await_gone(second)
    stage.await_running(waited)
    assert stage.releases_of(patient) == {waited}

    urgent = asked(stage, "p10-urgent", "vehicle-01", priority=900, conflictPolicy="Preempt")
    stage.await_running(second)
    stage.await_gone(first)
    assert urgent.rpartition("/")[2] in stage.await_reason(low, "Preempted")["message"]
    assert stage.releases_of(low) == stage.releases_of(refused) == set()
    assert {key: stage.releases_of(key) for key in (urgent, patient, offloaded)} == {
        urgent: {second},
        patient: {waited},
        offloaded: {elsewhere},
    }
