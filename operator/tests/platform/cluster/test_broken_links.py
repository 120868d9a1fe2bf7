"""A link that the broker does not let pass is told of its task, and of no other; it passes as soon as it may."""

from __future__ import annotations

import pytest

from ci import publish
from tests.stages.platform.running_platform import Platform, asleep, eventually
from tests.stages.platform.table_one import Stage

pytestmark = pytest.mark.thorough

CHART = "object-detection"
OBJECTS = "link /vehicles/vehicle_01/objects never reaches cloud-0"


def ask_for(stage: Stage, agent: str) -> str:
    """The detection on an agent's own clouds, whose objects the cloud shall hear."""
    parameters, placement = {"sensor": agent}, {"agents": [agent]}
    return stage.submit("cloud-0", f"see-{agent}", application=CHART, parameters=parameters, placement=placement)


def ready(stage: Stage, key: str) -> tuple[str, str]:
    """Status and reason of a task's condition Ready."""
    condition = stage.condition(key, "Ready")
    return condition.get("status", ""), condition.get("reason", "")


def test_what_the_broker_refuses_makes_its_own_task_unready(platform: Platform, stage: Stage) -> None:
    publish.publish(platform.access.kubeconfig, extra=(CHART,))
    other = ask_for(stage, "vehicle-00")
    eventually("the other task is ready", lambda: ready(stage, other)[0] == "True")
    with asleep(platform, "rights"):  # nobody lets the cloud hear another topic
        key = ask_for(stage, "vehicle-01")
        eventually("the broken link is told", lambda: ready(stage, key) == ("False", "LinkBroken"))
        assert OBJECTS in stage.condition(key, "Ready")["message"]
        assert ready(stage, other)[0] == "True"
    eventually("the link passes", lambda: ready(stage, key)[0] == "True")
    assert ready(stage, other)[0] == "True"
