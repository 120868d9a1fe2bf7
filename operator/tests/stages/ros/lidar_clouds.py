"""Clouds as a lidar on a road sees them, with or without another vehicle."""

from __future__ import annotations

import math

import numpy as np

from scenarios.generator import messages, scene

FRAME = "vehicle_00/lidar_center"
MOUNT = scene.MOUNTS[0]
OWN = scene.Place(0.0, -4.0, 0.0)
NOWHERE = scene.Place(0.0, 10_000.0, 0.0)


def cloud(
    *others: scene.Place,
    stamp: int = 1,
    points: int = 20_000,
    seed: int = 1,
    own: scene.Place = OWN,
    frame: str = FRAME,
) -> bytes:
    """A serialised PointCloud2 of the lidar on a vehicle at `own`, with others at these places."""
    rays = scene.ray_directions(points)
    noise = np.random.default_rng(seed).standard_normal(len(rays), np.float32) * np.float32(scene.NOISE_M)
    return messages.CloudWriter(frame, len(rays)).message(
        stamp, scene.cast(rays, MOUNT, own, others or [NOWHERE], noise)
    )


def seen_at(other: scene.Place) -> tuple[float, float]:
    """Where the lidar has the other vehicle's centre, in its own frame."""
    x, y = other.x - OWN.x - MOUNT.x, other.y - OWN.y - MOUNT.y
    cosine = math.cos(MOUNT.yaw)
    sine = math.sin(MOUNT.yaw)
    return cosine * x + sine * y, cosine * y - sine * x
