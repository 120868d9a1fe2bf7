"""A vehicle and an intersection with a road-side unit, made of poses, and of clouds of their lidars where a story needs
them: no bag is needed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any

from scenarios.definition import cloud_topic, pose_topic
from scenarios.generator.intersection import STOPPED, UNIT
from scenarios.generator.messages import CLOUD_TYPE, POSE_TYPE
from scenarios.generator.scene import Place
from tests.stages.platform.table_one import BRIDGE, Stage, pose
from tests.stages.scenarios.corner import CLOUD_HZ, SITE, VEHICLE, View, cloud

__all__ = ["SITE", "SITE_SERVICES", "VEHICLE", "approached", "left", "operator", "seeing"]

SENSORS = {SITE: f"{SITE}/{BRIDGE}", VEHICLE: f"{VEHICLE}/object-detection-{VEHICLE}"}
"""In whose pods the lidars speak: those of a bridge have room for three small programs beside it, and no more."""
SITE_SERVICES = (f"{SITE}/object-detection-{SITE}", f"{SITE}/object-tracking-{SITE}")
START_M, STOP_M = 200, 250
FAR = Place(1000.0, STOPPED.y, 0.0)


def operator(application: str) -> dict[str, Any]:
    """What a person adds to the initial configuration: the cloud's operator, which asks for `application`."""
    distances = {"start_distance_m": START_M, "stop_distance_m": STOP_M}
    parameters = {"site": SITE, "vehicles": [VEHICLE], "application": application, **distances}
    return {"application": "intersection-operator", "agents": ["cloud-0"], "parameters": parameters}


def approached(stage: Stage) -> AbstractContextManager[None]:
    """The vehicle stops at the intersection as long as this lasts."""
    return _at(stage, STOPPED)


def left(stage: Stage) -> AbstractContextManager[None]:
    """The vehicle is far from it."""
    return _at(stage, FAR)


@contextmanager
def seeing(stage: Stage, *views: View) -> Iterator[None]:
    """Lidars see what they do from where they stand, as long as this lasts."""
    with ExitStack() as every:
        for view in views:
            message = (cloud_topic(view.agent), CLOUD_TYPE, cloud(view))
            every.enter_context(stage.publishing(SENSORS[view.agent], message, hertz=CLOUD_HZ))
        yield


@contextmanager
def _at(stage: Stage, place: Place) -> Iterator[None]:
    with ExitStack() as both:
        for agent, there in ((SITE, UNIT), (VEHICLE, place)):
            poses = (pose_topic(agent), POSE_TYPE, pose(there.x, there.y))
            both.enter_context(stage.publishing(f"{agent}/{BRIDGE}", poses))
        yield
