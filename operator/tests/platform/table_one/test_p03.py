"""An operator is a person or software that manages application deployments, life cycles, cluster configurations and
more.

Example: A cloud-based operator application detects a vehicle approaching an intersection and deploys a perception
application to a road-side unit to support the vehicle.

Story: A person's pull request launches the operator in the cloud. The vehicle's poses near the intersection lead to
perception on the road-side unit, without anybody's doing; its poses far away take it back.

Asserted: on main, that the operator was asked for by a person and perception by a task of a rule; on the pods' Nodes,
that perception runs on the road-side unit; on pods and tasks, that nothing is left. The poses are published on the
vehicle and the road-side unit; the operator acts on what reaches the cloud.
"""

from __future__ import annotations

from tests.stages.platform.intersection import SITE_SERVICES
from tests.stages.platform.three_operators import ThreeOperators


def test_a_person_launches_software_that_launches_perception(operators: ThreeOperators) -> None:
    assert operators.launch.trailers["Cause"] == ("initial",)
    assert set(operators.supporting) == set(SITE_SERVICES)
    assert operators.roles == {"roadside"}
    assert operators.support.trailers["Task"]
    assert operators.support.trailers["Rule"]
