"""An operator is a person or software that manages application deployments, life cycles, cluster configurations and
more.

Example: A cloud-based operator application detects a vehicle approaching an intersection and deploys a perception
application to a road-side unit to support the vehicle.

Story: A person's pull request launches the operator in the cloud. The vehicle's poses near the intersection lead to
perception on the road-side unit, without anybody's doing; its poses far away take it back.
"""

from __future__ import annotations

from tests.stages.platform.intersection import SITE_SERVICES, approached, left, operator
from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import Stage

OPERATOR = "cloud-0/intersection-operator"


def test_a_person_launches_software_that_launches_perception(stage: Stage) -> None:
    with stage.asked_by_a_person(operator("roadside-operator")):
        stage.await_running(OPERATOR)
        asked = stage.commit_of(OPERATOR)
        assert asked.trailers["Cause"] == ("initial",)
        with approached(stage):
            pods = stage.await_running(*SITE_SERVICES)
            assert {stage.node_labels(pod.node)["robotkube.io/role"] for pod in pods.values()} == {"roadside"}
            made = stage.commit_of(SITE_SERVICES[0])
            assert made.trailers["Task"]
            assert made.trailers["Rule"]
        with left(stage):
            stage.await_gone(*SITE_SERVICES)
            eventually("no task is left on the road-side unit", lambda: not stage.tasks("roadside-0"))
