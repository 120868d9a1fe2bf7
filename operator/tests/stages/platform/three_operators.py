"""Three operators on three agents, as a person has them launched together: the cloud's, which has an intersection
supported, one on an edge server, which has recorded what a vehicle and the road-side unit see there, and one on the
vehicle, which has its meeting with another vehicle recorded. Played once, for two stories of Table I."""

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

EDGE = "edge-0"
CLOUDS_OPERATOR = "cloud-0/intersection-operator"
EDGES_OPERATOR, VEHICLES_OPERATOR = f"{EDGE}/event-detector", f"{VEHICLE}/event-detector"
OTHER_VEHICLE = "vehicle-01"
MEETING_M = 60.0
APART_M = 2000.0
RECORDER = f"cloud-0/recorder-{VEHICLE}-{OTHER_VEHICLE}"
CLOUDS_OWN = {"application": "proximity-operator", "agents": ["cloud-0"]}  # which would record the meeting as well
Tasks = Mapping[str, Mapping[str, Any]]


def _recording_operator(agent: str, *watched: str) -> dict[str, Any]:
    """What a person adds to the initial configuration: an operator that has meetings of two agents recorded."""
    parameters = {"agents": list(watched), "start_distance_m": 200, "stop_distance_m": 250}
    return {"application": "proximity-operator", "agents": [agent], "parameters": parameters}


@dataclass(frozen=True)
class ThreeOperators:
    """What was seen. `launch` is the commit of the cloud's operator, `support` that of what it asked for. While all
    demands stood: the pods that support, with the roles of their nodes, and the vehicle's recorder; the tasks of the
    three agents, and those that the recorder's release names; what runs for the edge server's task; where the agents
    whose poses each operator acts on are, as was received beside it. Once the vehicle's meeting alone was over: the
    pods of both others."""

    launch: Commit
    support: Commit
    supporting: Mapping[str, Pod]
    roles: frozenset[str]
    recording: Pod
    recorded_for: frozenset[str]
    clouds_tasks: Tasks
    edges_tasks: Tasks
    vehicles_tasks: Tasks
    for_the_edge: Mapping[str, Pod]
    heard: Mapping[str, tuple[float, float]]
    stayed: Mapping[str, Pod]


def play(stage: Stage) -> ThreeOperators:
    """From the person's pull request until nothing is left of what all asked for."""
    asked = (
        operator("roadside-operator"),
        _recording_operator(EDGE, SITE, VEHICLE),
        _recording_operator(VEHICLE, VEHICLE, OTHER_VEHICLE),
    )
    with stage.asked_by_a_person(*asked, instead_of=[CLOUDS_OWN]):
        stage.await_running(CLOUDS_OPERATOR, EDGES_OPERATOR, VEHICLES_OPERATOR)
        stage.await_gone("cloud-0/event-detector")
        launch = stage.commit_of(CLOUDS_OPERATOR)
        with approached(stage):
            seen = _met(stage, launch)
        with left(stage):
            stage.await_gone(*SITE_SERVICES, *seen.for_the_edge)
            eventually(
                "no task is left of the operators of cloud and edge, nor on the road-side unit",
                lambda: not any(stage.tasks(agent) for agent in ("cloud-0", EDGE, SITE)),
            )
    return seen


def _met(stage: Stage, launch: Commit) -> ThreeOperators:
    """The vehicle is near the intersection; it meets the other one, and does not any more."""
    with stage.publishing(f"{OTHER_VEHICLE}/{BRIDGE}", (pose_topic(OTHER_VEHICLE), POSE_TYPE, pose(MEETING_M))):
        supporting = stage.await_running(*SITE_SERVICES)
        recording = stage.await_running(RECORDER)[RECORDER]
        [edges_task] = eventually("the edge server's operator has asked", lambda: list(stage.tasks(EDGE)))
        for_the_edge = stage.await_running(*stage.await_releases_of(edges_task))
        heard = {
            agent: _position(stage, agent, whose)
            for agent, whose in (("cloud-0", VEHICLE), (EDGE, VEHICLE), (VEHICLE, OTHER_VEHICLE))
        }
        clouds_tasks, edges_tasks, vehicles_tasks = (stage.tasks(agent) for agent in ("cloud-0", EDGE, VEHICLE))
        support = stage.commit_of(SITE_SERVICES[0])
        recorded_for = stage.annotation(RECORDER, "tasks").split()
        roles = {stage.node_labels(pod.node)["robotkube.io/role"] for pod in supporting.values()}
    with stage.publishing(f"{OTHER_VEHICLE}/{BRIDGE}", (pose_topic(OTHER_VEHICLE), POSE_TYPE, pose(APART_M))):
        stage.await_gone(RECORDER)
    return ThreeOperators(
        launch=launch,
        support=support,
        supporting=supporting,
        roles=frozenset(roles),
        recording=recording,
        recorded_for=frozenset(recorded_for),
        clouds_tasks=clouds_tasks,
        edges_tasks=edges_tasks,
        vehicles_tasks=vehicles_tasks,
        for_the_edge=for_the_edge,
        heard=heard,
        stayed=stage.await_running(*SITE_SERVICES, *for_the_edge),
    )


def _position(stage: Stage, agent: str, whose: str) -> tuple[float, float]:
    """Where another agent is, by its pose as it is heard on this one."""
    [said] = stage.receive(f"{agent}/{BRIDGE}", pose_topic(whose), POSE_TYPE)
    return said.pose.position.x, said.pose.position.y
