"""The corner of the intersection at which a container blocks a vehicle's view of another one, as lidars see it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from scenarios.definition import ros_name
from scenarios.generator import messages, scene
from scenarios.generator.intersection import CONTAINER, HIDDEN, STOPPED, UNIT

SITE, VEHICLE = "roadside-0", "vehicle-00"
ABOVE, BELOW = 0.15, 0.1  # the bounds of uncertainty-operator
CLOUD_HZ = 5
POINTS = 20_000
NEAR_M = 1.0  # a detection that close is one of the vehicle
STANDING = {SITE: (UNIT, scene.ROADSIDE_MOUNT), VEHICLE: (STOPPED, scene.MOUNTS[0])}


class View(NamedTuple):
    """Whose lidar sees the corner, and whether the container stands there."""

    agent: str
    blocked: bool


BLOCKED, CLEAR, SITES = View(VEHICLE, True), View(VEHICLE, False), View(SITE, True)


def cloud(view: View, stamp: int = 0) -> bytes:
    """A serialised PointCloud2: the hidden vehicle, the container if it stands there, and for the road-side unit the
    vehicle that stops, too."""
    own, mount = STANDING[view.agent]
    rays = scene.ray_directions(POINTS)
    noise = np.random.default_rng(1).standard_normal(len(rays), np.float32) * np.float32(scene.NOISE_M)
    others = [HIDDEN] if view.agent == VEHICLE else [HIDDEN, STOPPED]
    points = scene.cast(rays, mount, own, others, noise, [CONTAINER] if view.blocked else [])
    return messages.CloudWriter(f"{ros_name(view.agent)}/lidar_center", len(rays)).message(stamp, points)


def in_map(agent: str, x: float, y: float) -> tuple[float, float]:
    """Where in frame `map` a place is that an agent's lidar has at x, y in its own frame."""
    own, mount = STANDING[agent]
    x, y = _turned(x, y, mount.yaw)
    x, y = _turned(x + mount.x, y + mount.y, own.yaw)
    return own.x + x, own.y + y


def hidden_among(agent: str, places: list[tuple[float, float]]) -> bool:
    """Return whether the hidden vehicle is one of the places that an agent's lidar has in its own frame."""
    return any(math.dist(in_map(agent, x, y), (HIDDEN.x, HIDDEN.y)) < NEAR_M for x, y in places)


def _turned(x: float, y: float, angle: float) -> tuple[float, float]:
    return math.cos(angle) * x - math.sin(angle) * y, math.sin(angle) * x + math.cos(angle) * y
