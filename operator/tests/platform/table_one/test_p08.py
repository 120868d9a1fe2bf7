"""Operator applications may deploy other operator applications forming operator application chains.

Example: One cloud-based operator application deploys another vehicle-based operator application to vehicles approaching
an intersection. The vehicle-based operator application detects uncertainty in order to eventually deploy an environment
perception application on the connected intersection infrastructure.

Story: Poses near the intersection launch an operator on the vehicle; nothing else yet. The vehicle's own detection
becomes uncertain, and that operator has perception run on the road-side unit. Its task names the task that launched it;
when the vehicle has left, all of it goes.
"""

from __future__ import annotations

from tests.stages.platform.intersection import SITE_SERVICES, VEHICLE, approached, left, operator
from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import BRIDGE, NUMBER, Stage, number

LAUNCHED = (f"{VEHICLE}/uncertainty-operator-roadside-0", f"{VEHICLE}/object-detection-{VEHICLE}")
UNCERTAINTY = f"/vehicles/{VEHICLE.replace('-', '_')}/uncertainty"


def test_an_operator_launches_an_operator_that_launches_perception(stage: Stage) -> None:
    with stage.asked_by_a_person(operator("uncertainty-operator")):
        stage.await_running("cloud-0/intersection-operator")
        with approached(stage):
            stage.await_running(*LAUNCHED)
            [parent] = stage.tasks("cloud-0")
            assert stage.tasks(VEHICLE) == {}
            assert not set(SITE_SERVICES) & set(stage.releases())
            with stage.publishing(f"{VEHICLE}/{BRIDGE}", (UNCERTAINTY, NUMBER, number(0.9))):
                pods = stage.await_running(*SITE_SERVICES)
                assert {pod.node for pod in pods.values()} == {"roadside-0"}
                [(child, task)] = stage.tasks(VEHICLE).items()
                assert task["spec"]["chain"]["parent"] == parent
                assert stage.annotation(SITE_SERVICES[0], "tasks") == child
                assert stage.commit_of(SITE_SERVICES[0]).trailers["Task"] == (child,)
                assert stage.commit_of(LAUNCHED[0]).trailers["Task"] == (parent,)
        with left(stage):
            stage.await_gone(*LAUNCHED, *SITE_SERVICES)
            eventually("no task is left", lambda: not stage.tasks("cloud-0") and not stage.tasks(VEHICLE))
