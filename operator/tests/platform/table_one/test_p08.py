"""Operator applications may deploy other operator applications forming operator application chains.

Example: One cloud-based operator application deploys another vehicle-based operator application to vehicles approaching
an intersection. The vehicle-based operator application detects uncertainty in order to eventually deploy an environment
perception application on the connected intersection infrastructure.

Story: Poses near the intersection launch an operator on the vehicle, and a detection with the vehicle's own lidar. It
sees a vehicle in the side street and is sure of it; nothing else happens. Then a container stands at the corner, fewer
of the lidar's rays reach that vehicle, and the detection becomes uncertain: the operator has perception run on the
road-side unit. What the road-side unit sees arrives on the vehicle: the hidden vehicle is among it, where it stands.
The operator's task names the task that launched it; when the vehicle has left, all of it goes.

Asserted: on messages that are received on the vehicle: its own detection's uncertainty, below the rule's lower bound
first and above its upper one then, both computed from clouds whose rays end at what they hit first; the road-side
unit's objects and tracks, among them the hidden vehicle within a metre of where it stands. On tasks and main, that no
perception is asked for before, and who asked for what; on the pods' Nodes, that perception runs on the road-side unit;
on pods and tasks, that nothing is left.
"""

from __future__ import annotations

import json

import pytest

from ci import publish
from tests.stages.platform.intersection import SITE, SITE_SERVICES, VEHICLE, approached, left, operator, seeing
from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import BRIDGE, NUMBER, POSES, TEXT, Stage
from tests.stages.scenarios.corner import ABOVE, BELOW, BLOCKED, CLEAR, SITES, hidden_among

pytestmark = pytest.mark.thorough

OPERATOR = f"{VEHICLE}/uncertainty-operator-{SITE}"
LAUNCHED = (OPERATOR, f"{VEHICLE}/object-detection-{VEHICLE}")
ON_THE_VEHICLE = f"{VEHICLE}/{BRIDGE}"
COUNT = 5


def uncertainties(stage: Stage) -> list[float]:
    """What the vehicle's own detection says of how uncertain it is."""
    return [one.data for one in stage.receive(OPERATOR, "/vehicles/vehicle_00/uncertainty", NUMBER, COUNT)]


def assert_hidden_vehicle_is_known(stage: Stage) -> None:
    """The vehicle hears of the hidden one what the road-side unit sees, as objects and as a track of one identity."""
    objects = stage.receive(ON_THE_VEHICLE, "/vehicles/roadside_0/objects", POSES, COUNT)
    for message in objects:
        assert message.header.frame_id == "roadside_0/lidar_center"
        assert hidden_among(SITE, [(pose.position.x, pose.position.y) for pose in message.poses])
    [*_, answer] = stage.receive(ON_THE_VEHICLE, "/vehicles/roadside_0/tracks", TEXT, COUNT)
    assert hidden_among(SITE, [(one["x"], one["y"]) for one in json.loads(answer.data)["tracks"]])


def test_an_operator_launches_an_operator_that_launches_perception(stage: Stage) -> None:
    publish.publish(stage.platform.access.kubeconfig, extra=("object-detection",))  # the one before sees 25 m, by size
    with stage.asked_by_a_person(operator("uncertainty-operator")):
        stage.await_running("cloud-0/intersection-operator")
        with approached(stage):
            stage.await_running(*LAUNCHED)
            [parent] = stage.tasks("cloud-0")
            with seeing(stage, CLEAR):
                assert all(0 < uncertainty < BELOW for uncertainty in uncertainties(stage))
                assert stage.tasks(VEHICLE) == {}
                assert not set(SITE_SERVICES) & set(stage.releases())
            with seeing(stage, BLOCKED, SITES):
                pods = stage.await_running(*SITE_SERVICES)
                assert min(uncertainties(stage)) > ABOVE
                assert {pod.node for pod in pods.values()} == {SITE}
                assert_hidden_vehicle_is_known(stage)
                [(child, task)] = stage.tasks(VEHICLE).items()
                assert task["spec"]["chain"]["parent"] == parent
                assert stage.annotation(SITE_SERVICES[0], "tasks") == child
                assert stage.commit_of(SITE_SERVICES[0]).trailers["Task"] == (child,)
                assert stage.commit_of(OPERATOR).trailers["Task"] == (parent,)
        with left(stage):
            stage.await_gone(*LAUNCHED, *SITE_SERVICES)
            eventually("no task is left", lambda: not stage.tasks("cloud-0") and not stage.tasks(VEHICLE))
