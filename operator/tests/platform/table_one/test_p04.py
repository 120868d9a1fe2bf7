"""Different applications are managed by different decentralized application-specific operators.

Example: In addition to the above cloud-based operator application for deploying supportive infrastructure functions,
the deployment of a recording application is handled by another, separate vehicle-based operator application.

Story: The cloud's operator supports an intersection while one on a vehicle has the meeting of two vehicles recorded.
The vehicle hears the other one by a link that its operator asks for: each says its own pose alone. Each operator gives
tasks in its own agent's namespace only; when one has ended its demand, what the other asked for stays, the same pods.

Asserted: on the tasks in the namespaces of cloud and vehicle, whose they are and what they ask for; on main, which
tasks the recorder answers; on the pods' identities, that the supporting ones are the same afterwards. Each pose is
published on its own agent, and the operators act on what reaches them over links.
"""

from __future__ import annotations

from collections.abc import Mapping

from tests.stages.platform.table_one import Pod
from tests.stages.platform.two_operators import VEHICLES_OPERATOR, Tasks, TwoOperators


def applications(tasks: Tasks) -> set[str]:
    """What the tasks ask for."""
    return {task["spec"]["application"] for task in tasks.values()}


def identities(pods: Mapping[str, Pod]) -> dict[str, str]:
    """Release -> identity of its pod."""
    return {release: pod.uid for release, pod in pods.items()}


def test_two_operators_on_two_agents_do_not_touch_each_other(operators: TwoOperators) -> None:
    assert applications(operators.clouds_tasks) == {"roadside-operator"}
    assert applications(operators.vehicles_tasks) == {"pose-point-cloud-recording"}
    assert {task["spec"]["requester"] for task in operators.vehicles_tasks.values()} == {VEHICLES_OPERATOR}
    assert operators.recorded_for == set(operators.vehicles_tasks)
    assert operators.recording.node == "cloud-0"
    assert identities(operators.stayed) == identities(operators.supporting)
