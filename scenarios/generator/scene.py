"""What a lidar sees: flat ground, walls along the road with gaps between them, other vehicles and obstacles as boxes.

Every ray points below the horizon and so hits something; a cloud always has the same number of points. A ray ends at
what it hits first: of a vehicle behind an obstacle only those points are in the cloud that are in plain view. Frames:
`map`; a vehicle's frame (origin on the ground at its centre, x ahead); the lidar's frame (offset and yaw against the
vehicle's).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CHANNELS = 32
ELEVATION_DEGREES = (0.6, 24.0)  # below the horizon; closer together near it, where far things are
VEHICLE_SIZE_M = (4.6, 1.9, 1.6)
WALL_DISTANCE_M = 15.0  # from the middle of the road
WALL_HEIGHT_M = 4.0
WALL_PERIOD_M, WALL_LENGTH_M = 60.0, 35.0
NOISE_M = 0.01
GROUND, WALL, VEHICLE = 0.2, 0.5, 0.9  # intensities

Floats32 = NDArray[np.float32]


@dataclass(frozen=True)
class Mount:
    """The mount of a lidar on its vehicle: offset in m and yaw in rad, in the vehicle's frame."""

    x: float
    y: float
    z: float
    yaw: float


MOUNTS = (Mount(1.2, 0.1, 1.9, 0.15), Mount(0.9, -0.2, 1.95, -0.25), Mount(1.1, 0.15, 1.85, 0.2))
ROADSIDE_MOUNT = Mount(0.0, 0.0, 3.0, 0.3)


@dataclass(frozen=True)
class Place:
    """A vehicle's position in m in frame `map`, on the ground, and heading in rad."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True)
class Obstacle:
    """A thing that stands in the way of rays, such as a container: a box on the ground of this length, width and
    height, which reflects as a wall does."""

    place: Place
    size_m: tuple[float, float, float]


def ray_directions(points_min: int) -> Floats32:
    """Unit vectors of all rays in the lidar's frame, (n, 3) with n the next multiple of 32 from `points_min`."""
    columns = math.ceil(points_min / CHANNELS)
    near, far = ELEVATION_DEGREES
    elevation = -np.radians(np.geomspace(near, far, CHANNELS))[:, None]
    azimuth = np.linspace(0.0, 2 * math.pi, columns, endpoint=False)[None, :] - math.pi
    rays = np.empty((CHANNELS, columns, 3))
    rays[..., 0] = np.cos(elevation) * np.cos(azimuth)
    rays[..., 1] = np.cos(elevation) * np.sin(azimuth)
    rays[..., 2] = np.sin(elevation)
    return rays.reshape(-1, 3).astype(np.float32)


def cast(
    rays: Floats32,
    mount: Mount,
    own: Place,
    others: Iterable[Place],
    noise: Floats32,
    obstacles: Iterable[Obstacle] = (),
) -> Floats32:
    """The cloud one revolution gives: (n, 4) of x, y, z in m in the lidar's frame and intensity.

    `noise` holds one deviation of the range in m per ray.
    """
    origin = (
        own.x + math.cos(own.yaw) * mount.x - math.sin(own.yaw) * mount.y,
        own.y + math.sin(own.yaw) * mount.x + math.cos(own.yaw) * mount.y,
    )
    ranges = -mount.z / rays[:, 2]
    intensity = np.full(len(rays), GROUND, np.float32)
    along_x, along_y = _turned(rays, own.yaw + mount.yaw)
    _nearest(ranges, intensity, _wall_ranges(origin, mount.z, along_x, along_y, rays[:, 2]), WALL)
    boxes = [(other, VEHICLE_SIZE_M, VEHICLE) for other in others]
    boxes += [(obstacle.place, obstacle.size_m, WALL) for obstacle in obstacles]
    for box, size_m, reflected in boxes:
        hit = _box_ranges(origin, mount.z, rays, own.yaw + mount.yaw, box, size_m)
        _nearest(ranges, intensity, hit, reflected)
    cloud = np.empty((len(rays), 4), np.float32)
    cloud[:, :3] = rays * (ranges + noise)[:, None]
    cloud[:, 3] = intensity
    return cloud


def _turned(rays: Floats32, angle: float) -> tuple[Floats32, Floats32]:
    """x and y parts of the rays in a frame in which the lidar's heading is `angle`."""
    cosine, sine = np.float32(math.cos(angle)), np.float32(math.sin(angle))
    return cosine * rays[:, 0] - sine * rays[:, 1], sine * rays[:, 0] + cosine * rays[:, 1]


def _nearest(ranges: Floats32, intensity: Floats32, candidates: Floats32, value: float) -> None:
    closer = candidates < ranges
    ranges[closer] = candidates[closer]
    intensity[closer] = value


def _wall_ranges(
    origin: tuple[float, float], height: float, along_x: Floats32, along_y: Floats32, along_z: Floats32
) -> Floats32:
    """Range to the wall on the ray's side of the road, infinite where there is a gap or the ray passes above."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = (np.copysign(np.float32(WALL_DISTANCE_M), along_y) - np.float32(origin[1])) / along_y
        x = np.float32(origin[0]) + ranges * along_x
        z = np.float32(height) + ranges * along_z
        hit = (np.mod(x, np.float32(WALL_PERIOD_M)) < WALL_LENGTH_M) & (z >= 0) & (z <= WALL_HEIGHT_M)
    return np.where(hit, ranges, np.float32(np.inf))


def _box_ranges(
    origin: tuple[float, float],
    height: float,
    rays: Floats32,
    heading: float,
    box: Place,
    size_m: tuple[float, float, float],
) -> Floats32:
    """Range to a box by the slab method, infinite where the ray misses it."""
    dx, dy = origin[0] - box.x, origin[1] - box.y
    start = (
        math.cos(box.yaw) * dx + math.sin(box.yaw) * dy,
        -math.sin(box.yaw) * dx + math.cos(box.yaw) * dy,
        height - size_m[2] / 2,
    )
    along = (*_turned(rays, heading - box.yaw), rays[:, 2])
    entry = np.zeros(len(rays), np.float32)
    leave = np.full(len(rays), np.inf, np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in range(3):
            half = size_m[axis] / 2
            low, high = (-half - start[axis]) / along[axis], (half - start[axis]) / along[axis]
            np.maximum(entry, np.minimum(low, high), out=entry)
            np.minimum(leave, np.maximum(low, high), out=leave)
    return np.where((entry < leave) & (entry > 0), entry, np.float32(np.inf))
