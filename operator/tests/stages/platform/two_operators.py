"""Two operators on two agents, as a person has them launched together: the cloud's, which has an intersection
supported, and one on a vehicle, which has its meeting with another vehicle recorded. Played once, for two stories of
Table I."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scenarios.definition import pose_topic
from scenarios.generator.messages import POSE_TYPE
from scenarios.runner.inputs import Commit
from tests.stages.platform.intersection import SITE, SITE_SERVICES, VEHICLE, approached, left, operator
from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import BRIDGE, Pod, Stage, pose

CLOUDS_OPERATOR, VEHICLES_OPERATOR = "cloud-0/intersection-operator", f"{VEHICLE}/event-detector"
OTHER_VEHICLE = "vehicle-01"
RECORDER = f"cloud-0/recorder-{VEHICLE}-{OTHER_VEHICLE}"
RECORDING_OPERATOR = {
    "application": "proximity-operator",
    "agents": [VEHICLE],
    "parameters": {"agents": [VEHICLE, OTHER_VEHICLE], "start_distance_m": 200, "stop_distance_m": 250},
}
CLOUDS_OWN = {"application": "proximity-operator", "agents": ["cloud-0"]}  # which would record the meeting as well
Tasks = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class TwoOperators:
    """What was seen. `launch` is the commit of the cloud's operator, `support` that of what it asked for. While both
    demands stood: the pods that support, with the roles of their nodes, and the recorder's; tasks of cloud and vehicle,
    and those that the recorder's release names. Once the meeting alone was over: the pods that support."""

    launch: Commit
    support: Commit
    supporting: Mapping[str, Pod]
    roles: frozenset[str]
    recording: Pod
    recorded_for: frozenset[str]
    clouds_tasks: Tasks
    vehicles_tasks: Tasks
    stayed: Mapping[str, Pod]


def play(stage: Stage) -> TwoOperators:
    """From the person's pull request until nothing is left of what both asked for."""
    asked = (operator("roadside-operator"), RECORDING_OPERATOR)
    with stage.asked_by_a_person(*asked, instead_of=[CLOUDS_OWN]):
        stage.await_running(CLOUDS_OPERATOR, VEHICLES_OPERATOR)
        stage.await_gone("cloud-0/event-detector")
        launch = stage.commit_of(CLOUDS_OPERATOR)
        with approached(stage):
            seen = _met(stage, launch)
        with left(stage):
            stage.await_gone(*SITE_SERVICES)
            eventually(
                "no task is left of the cloud's operator, nor on the road-side unit",
                lambda: not stage.tasks("cloud-0") and not stage.tasks(SITE),
            )
    return seen


def _met(stage: Stage, launch: Commit) -> TwoOperators:
    """The vehicle is near the intersection; it meets the other one, and does not any more."""
    with stage.publishing(f"{OTHER_VEHICLE}/{BRIDGE}", (pose_topic(OTHER_VEHICLE), POSE_TYPE, pose(60.0))):
        supporting = stage.await_running(*SITE_SERVICES)
        recording = stage.await_running(RECORDER)[RECORDER]
        clouds_tasks, vehicles_tasks = stage.tasks("cloud-0"), stage.tasks(VEHICLE)
        support = stage.commit_of(SITE_SERVICES[0])
        recorded_for = stage.annotation(RECORDER, "tasks").split()
        roles = {stage.node_labels(pod.node)["robotkube.io/role"] for pod in supporting.values()}
    with stage.publishing(f"{OTHER_VEHICLE}/{BRIDGE}", (pose_topic(OTHER_VEHICLE), POSE_TYPE, pose(2000.0))):
        stage.await_gone(RECORDER)
    return TwoOperators(
        launch=launch,
        support=support,
        supporting=supporting,
        roles=frozenset(roles),
        recording=recording,
        recorded_for=frozenset(recorded_for),
        clouds_tasks=clouds_tasks,
        vehicles_tasks=vehicles_tasks,
        stayed=stage.await_running(*SITE_SERVICES),
    )
