"""Different applications are managed by different decentralized application-specific operators.

Example: In addition to the above cloud-based operator application for deploying supportive infrastructure functions,
the deployment of a recording application is handled by another, separate vehicle-based operator application.

Story: The cloud's operator supports an intersection, one on an edge server has recorded what a vehicle and the
road-side unit see there, and one on the vehicle has its meeting with another vehicle recorded. Edge server and vehicle
hear the others by links that their operators ask for: each agent says its own pose alone. Each operator gives tasks in
its own agent's namespace only; when one has ended its demand, what the others asked for stays, the same pods.

Asserted: on the tasks in the namespaces of cloud, edge server and vehicle, whose they are and what they ask for; on
main, which tasks the recorders answer; on messages that are received beside each operator, that the pose it acts on is
the one that was said on the other agent; on the pods' identities, that those of the two others are the same afterwards.
Each pose is published on its own agent, as its driver would, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from scenarios.generator.intersection import STOPPED
from tests.stages.platform.intersection import VEHICLE
from tests.stages.platform.table_one import Pod
from tests.stages.platform.three_operators import (
    EDGE,
    EDGES_OPERATOR,
    MEETING_M,
    RECORDER,
    VEHICLES_OPERATOR,
    Tasks,
    ThreeOperators,
)


def applications(tasks: Tasks) -> set[str]:
    """What the tasks ask for."""
    return {task["spec"]["application"] for task in tasks.values()}


def requesters(tasks: Tasks) -> set[str]:
    """Who asks."""
    return {task["spec"]["requester"] for task in tasks.values()}


def identities(pods: Mapping[str, Pod]) -> dict[str, str]:
    """Release -> identity of its pod."""
    return {release: pod.uid for release, pod in pods.items()}


def test_three_operators_on_three_agents_do_not_touch_each_other(operators: ThreeOperators) -> None:
    assert applications(operators.clouds_tasks) == {"roadside-operator"}
    assert applications(operators.edges_tasks) == {"pose-point-cloud-recording"}
    assert requesters(operators.edges_tasks) == {EDGES_OPERATOR}
    assert applications(operators.vehicles_tasks) == {"pose-point-cloud-recording"}
    assert requesters(operators.vehicles_tasks) == {VEHICLES_OPERATOR}
    assert operators.recorded_for == set(operators.vehicles_tasks)
    assert operators.recording.node == "cloud-0"
    assert RECORDER not in operators.for_the_edge
    assert identities(operators.stayed) == identities({**operators.supporting, **operators.for_the_edge})


def test_each_acts_on_what_reached_it(operators: ThreeOperators) -> None:
    assert operators.heard["cloud-0"] == pytest.approx((STOPPED.x, STOPPED.y))
    assert operators.heard[EDGE] == pytest.approx((STOPPED.x, STOPPED.y))
    assert operators.heard[VEHICLE] == pytest.approx((MEETING_M, 0.0))
