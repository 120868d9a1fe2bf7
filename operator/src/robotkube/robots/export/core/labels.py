"""Labels of point clouds: boxes of the other agents, by their own poses. Metres, rad, frame of the sensor. Pure.

Collective learning: nobody marks objects by hand. The other vehicle's own pose, interpolated at the cloud's stamp and
transformed into the sensor's frame, says what the cloud shows there.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from robotkube.robots.export.core.transforms import (
    Deviation,
    InterpolatedPose,
    PoseHistory,
    StaticTransforms,
    Transform,
    Vector,
)
from robotkube.robots.perception.core.point_clouds import Cloud

NANOSECONDS = 1_000_000_000
ACCELERATION_MAX = 10.0
"""m/s2; no road vehicle deviates from a straight line between two of its poses by more than this explains."""
TURN_ACCELERATION_MAX = 3.0
"""rad/s2, likewise for its heading."""
SIZE_DEFAULT = (4.6, 1.9, 1.6)
GAP_SECONDS_DEFAULT = 1.0
DISTANCE_DEFAULT = 120.0
MARGIN_M = 0.05


@dataclass(frozen=True)
class LabellingSettings:
    """The settings of a labelling. `size`: length, width, height of the others in m, their pose on the ground at the
    centre. Poses farther apart than `gap_seconds` are not joined; who is farther than `distance_m` is not labelled.
    `pose_sigma_m`, `heading_sigma_rad`: of poses that come without a covariance, as they were measured."""

    size: Vector = SIZE_DEFAULT
    gap_seconds: float = GAP_SECONDS_DEFAULT
    distance_m: float = DISTANCE_DEFAULT
    pose_sigma_m: float = 0.0
    heading_sigma_rad: float = 0.0


@dataclass(frozen=True)
class Label:
    """One box in the frame of the sensor. `position`: of its centre; `heading`: about its z axis; `age_seconds`: to the
    nearest pose message of that agent; `points` of the cloud lie in it."""

    agent: str
    position: Vector
    heading: float
    size: Vector
    distance_m: float
    age_seconds: float
    position_uncertainty_m: float
    heading_uncertainty_rad: float
    points: int = 0

    def document(self) -> dict[str, Any]:
        """The label as a line of labels.jsonl has it."""
        return asdict(self)


@dataclass
class AgentPoses:
    """Poses and transforms of all agents. `paths`: agent -> its poses; the frame of an agent's body is its ROS name."""

    paths: dict[str, PoseHistory]
    mounts: StaticTransforms
    bodies: Mapping[str, str]
    """Frame of the body -> agent."""

    def knows(self, frame: str) -> bool:
        """Return whether transforms lead from this frame to somebody's body."""
        return self.mounts.up_to(frame, list(self.bodies)) is not None

    def labels(self, frame: str, stamp: int, settings: LabellingSettings) -> list[Label] | None:
        """Labels of the others around a sensor; None when nobody knows where the sensor was then."""
        mount = self.mounts.up_to(frame, list(self.bodies))
        if mount is None:
            return None
        body, on_body = mount
        own = self.bodies[body]
        gap = int(settings.gap_seconds * NANOSECONDS)
        here = self.paths[own].at(stamp, gap)
        if here is None:
            return None
        sensor = here.transform @ on_body
        labels = []
        for agent, path in sorted(self.paths.items()):
            there = path.at(stamp, gap) if agent != own and path.frame == self.paths[own].frame else None
            if there is not None:
                label = _label(agent, sensor, here, there, settings)
                if label.distance_m <= settings.distance_m:
                    labels.append(label)
        return labels


def _label(
    agent: str, sensor: Transform, here: InterpolatedPose, there: InterpolatedPose, settings: LabellingSettings
) -> Label:
    relative = sensor.inverse @ there.transform
    centre = relative.apply((0.0, 0.0, settings.size[2] / 2))
    distance = math.hypot(*centre)
    given = Deviation(settings.pose_sigma_m, settings.heading_sigma_rad)
    own, other = here.deviation or given, there.deviation or given
    turn = math.hypot(own.heading_rad, _bound(TURN_ACCELERATION_MAX, here))
    position = math.hypot(
        own.position_m,
        other.position_m,
        _bound(ACCELERATION_MAX, here),
        _bound(ACCELERATION_MAX, there),
        turn * distance,
    )
    return Label(
        agent=agent,
        position=centre,
        heading=relative.heading,
        size=settings.size,
        distance_m=distance,
        age_seconds=there.age_ns / NANOSECONDS,
        position_uncertainty_m=position,
        heading_uncertainty_rad=math.hypot(turn, other.heading_rad, _bound(TURN_ACCELERATION_MAX, there)),
    )


def _bound(acceleration: float, placed: InterpolatedPose) -> float:
    """The most by which a straight line between two poses can be wrong: a t2 / 8."""
    return acceleration * (placed.span_ns / NANOSECONDS) ** 2 / 8


def points_within(label: Label, cloud: Cloud, margin: float = MARGIN_M) -> list[int]:
    """Numbers of the cloud's points that lie in the box, widened by `margin` for the sensor's noise."""
    cx, cy, cz = label.position
    length, width, height = (size / 2 + margin for size in label.size)
    cosine = math.cos(label.heading)
    sine = math.sin(label.heading)
    reach = math.hypot(length, width)
    within = []
    for index, (x, y) in enumerate(zip(cloud.x, cloud.y, strict=True)):
        dx, dy = x - cx, y - cy
        if -reach <= dx <= reach and -reach <= dy <= reach:
            along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
            if abs(along) <= length and abs(across) <= width and abs(cloud.z[index] - cz) <= height:
                within.append(index)
    return within


def corners(label: Label) -> list[tuple[float, float]]:
    """The box from above, front left first, against the clock."""
    x, y, _ = label.position
    length, width = label.size[0] / 2, label.size[1] / 2
    cosine = math.cos(label.heading)
    sine = math.sin(label.heading)
    return [
        (x + cosine * a - sine * b, y + sine * a + cosine * b)
        for a, b in ((length, width), (-length, width), (-length, -width), (length, -width))
    ]


def interleaved(cloud: Cloud) -> array[float]:
    """x, y, z, intensity of every point, one after the other, float32; intensity 0 when the sensor gives none."""
    columns = cloud.x, cloud.y, cloud.z, cloud.intensity or array("f", bytes(4 * len(cloud.x)))
    values = array("f", bytes(16 * len(cloud.x)))
    for place, column in enumerate(columns):
        values[place::4] = column
    return values
