"""Different applications are managed by different decentralized application-specific operators.

Example: In addition to the above cloud-based operator application for deploying supportive infrastructure functions,
the deployment of a recording application is handled by another, separate vehicle-based operator application.

Story: The cloud's operator supports an intersection while one on a vehicle has the meeting of two vehicles recorded.
Each gives tasks in its own agent's namespace only; when one has ended its demand, what the other asked for stays, the
same pods.
"""

from __future__ import annotations

from scenarios.definition import pose_topic
from scenarios.generator.messages import POSE_TYPE
from tests.stages.platform.intersection import SITE_SERVICES, VEHICLE, approached, left, operator
from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import BRIDGE, Stage, pose

MEETING = (VEHICLE, "vehicle-01")
RECORDER = "cloud-0/recorder-vehicle-00-vehicle-01"
RECORDING_OPERATOR = {
    "application": "proximity-operator",
    "agents": [VEHICLE],
    "parameters": {"agents": list(MEETING), "start_distance_m": 200, "stop_distance_m": 250},
}


def test_two_operators_on_two_agents_do_not_touch_each_other(stage: Stage) -> None:
    with stage.asked_by_a_person(operator("roadside-operator"), RECORDING_OPERATOR):
        stage.await_running("cloud-0/intersection-operator", f"{VEHICLE}/event-detector")
        with approached(stage):
            other = (pose_topic(MEETING[1]), POSE_TYPE, pose(60.0))  # as the vehicle hears of the other one
            with stage.publishing(f"{VEHICLE}/{BRIDGE}", other):
                supporting = stage.await_running(*SITE_SERVICES)
                recording = stage.await_running(RECORDER)
                clouds, vehicles = stage.tasks("cloud-0"), stage.tasks(VEHICLE)
                assert {task["spec"]["application"] for task in clouds.values()} == {"roadside-operator"}
                assert {task["spec"]["application"] for task in vehicles.values()} == {"pose-point-cloud-recording"}
                assert {task["spec"]["requester"] for task in vehicles.values()} == {f"{VEHICLE}/event-detector"}
                assert set(stage.annotation(RECORDER, "tasks").split()) == set(vehicles)
                assert recording[RECORDER].node == "cloud-0"
            gone = (pose_topic(MEETING[1]), POSE_TYPE, pose(2000.0))
            with stage.publishing(f"{VEHICLE}/{BRIDGE}", gone):
                stage.await_gone(RECORDER)
            stayed = stage.await_running(*SITE_SERVICES)
            assert {name: pod.uid for name, pod in stayed.items()} == {name: p.uid for name, p in supporting.items()}
        with left(stage):
            stage.await_gone(*SITE_SERVICES)
            eventually("no task of the cloud's operator is left", lambda: not stage.tasks("cloud-0"))
