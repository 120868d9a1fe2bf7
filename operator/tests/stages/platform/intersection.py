"""A vehicle and an intersection with a road-side unit, made of poses alone: no bag is needed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any

from scenarios.definition import pose_topic
from scenarios.generator.messages import POSE_TYPE
from tests.stages.platform.table_one import BRIDGE, Stage, pose

SITE, VEHICLE = "roadside-0", "vehicle-00"
SITE_SERVICES = (f"{SITE}/object-detection-{SITE}", f"{SITE}/object-tracking-{SITE}")
START_M, STOP_M = 200, 250
NEAR_M, FAR_M = 50.0, 1000.0


def operator(application: str) -> dict[str, Any]:
    """What a person adds to the initial configuration: the cloud's operator, which asks for `application`."""
    distances = {"start_distance_m": START_M, "stop_distance_m": STOP_M}
    parameters = {"site": SITE, "vehicles": [VEHICLE], "application": application, **distances}
    return {"application": "intersection-operator", "agents": ["cloud-0"], "parameters": parameters}


def approached(stage: Stage) -> AbstractContextManager[None]:
    """The vehicle is near the intersection as long as this lasts."""
    return _at(stage, NEAR_M)


def left(stage: Stage) -> AbstractContextManager[None]:
    """The vehicle is far from it."""
    return _at(stage, FAR_M)


@contextmanager
def _at(stage: Stage, distance_m: float) -> Iterator[None]:
    with ExitStack() as both:
        for agent, x in ((SITE, 0.0), (VEHICLE, distance_m)):
            both.enter_context(stage.publishing(f"{agent}/{BRIDGE}", (pose_topic(agent), POSE_TYPE, pose(x))))
        yield
