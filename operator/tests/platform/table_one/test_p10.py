"""Operator applications support automatic conflict resolution.

Example: If there are no compute resources left in a vehicle, an operator application is able to cancel or postpone
deployments, or resolve the conflict by other means such as offloading to a different connected agent.

Story: An edge server has room for two detections. A third, which a vehicle asks for with its own lidar, runs in the
cloud instead: the vehicle's clouds go there, and what is detected in them returns to the vehicle. A fourth waits, a
fifth is refused; when a place is free the one that waited runs; an urgent one has one of low priority cancelled. Git
and cluster show each, and each was told why.

Asserted: on main, which task has which release at which time; on the pods' Nodes, that the offloaded one runs in the
cloud; on messages that are received on the vehicle which asked: the one vehicle that stands in its lidar's cloud, in
the frame of its lidar, within a metre. On the tasks' conditions, that each was told why.
"""

from __future__ import annotations

import math
from typing import Any

import pytest

from scenarios.definition import cloud_topic
from scenarios.generator.messages import CLOUD_TYPE
from scenarios.generator.scene import Place
from tests.stages.platform.table_one import BRIDGE, POSES, Stage
from tests.stages.ros import lidar_clouds

pytestmark = pytest.mark.thorough

ASKING = "vehicle-02"
AHEAD = Place(20.0, 4.0, math.pi)  # the vehicle that its lidar sees
RESULTS = "/agents/cloud_0/vehicles/vehicle_02/objects"


def asked(stage: Stage, name: str, sensor: str, namespace: str = "cloud-0", **more: Any) -> str:
    """A detection that shall run on an edge server."""
    placement = {"roles": ["edge"]}
    parameters = {"sensor": sensor}
    return stage.submit(
        namespace, name, application="object-detection", parameters=parameters, placement=placement, **more
    )


def assert_results_return(stage: Stage) -> None:
    """What the detection in the cloud sees in the vehicle's clouds is heard on the vehicle."""
    frame = "vehicle_02/lidar_center"
    seen = (cloud_topic(ASKING), CLOUD_TYPE, lidar_clouds.cloud(AHEAD, frame=frame))
    with stage.publishing(f"{ASKING}/{BRIDGE}", seen, hertz=5):
        [*_, objects] = stage.receive(f"{ASKING}/{BRIDGE}", RESULTS, POSES, 5)
    assert objects.header.frame_id == frame
    [object_pose] = objects.poses
    assert math.dist((object_pose.position.x, object_pose.position.y), lidar_clouds.seen_at(AHEAD)) < 1.0


def test_demands_are_offloaded_postponed_refused_and_cancelled(stage: Stage) -> None:
    low = asked(stage, "p10-low", "vehicle-00", priority=50)
    first, second = "edge-0/object-detection-vehicle-00", "edge-0/object-detection-vehicle-01"
    stage.await_running(first)
    ordinary = asked(stage, "p10-ordinary", "vehicle-01")
    stage.await_running(second)

    offloaded = asked(stage, "p10-offloaded", ASKING, namespace=ASKING, conflictPolicy="Offload")
    elsewhere = "cloud-0/object-detection-vehicle-02"
    assert stage.await_running(elsewhere)[elsewhere].node == "cloud-0"
    assert stage.releases_of(offloaded) == {elsewhere}
    assert "offloaded to cloud" in stage.condition(offloaded)["message"]
    assert_results_return(stage)

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
