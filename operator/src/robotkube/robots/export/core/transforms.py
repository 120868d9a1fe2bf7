"""Rigid transforms between frames, and paths of frames over time. In m, quaternions x, y, z, w, stamps in ns. Pure."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

from robotkube.robots.ros.core.geometry import Quaternion, slerp

Vector = tuple[float, float, float]

CHAIN_MAX = 100
"""So many transforms, one behind the other, are followed."""


@dataclass(frozen=True)
class Transform:
    """Takes coordinates of a child frame to its parent's: turned by `rotation` (length 1), then moved."""

    translation: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def apply(self, point: Vector) -> Vector:
        """The point's coordinates in the parent frame."""
        x, y, z = _rotated(self.rotation, point)
        a, b, c = self.translation
        return x + a, y + b, z + c

    def __matmul__(self, inner: Transform) -> Transform:
        """The transform that applies `inner` first, then this one."""
        return Transform(self.apply(inner.translation), _product(self.rotation, inner.rotation))

    @property
    def inverse(self) -> Transform:
        """The transform from the parent to the child."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        a, b, c = _rotated(back, self.translation)
        return Transform((-a, -b, -c), back)

    @property
    def heading(self) -> float:
        """Angle of the child's x axis about the parent's z axis, rad."""
        x, y, z, w = self.rotation
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def transform(values: Sequence[float]) -> Transform | None:
    """The transform of position x, y, z and orientation x, y, z, w; None when they are no numbers. Length 0 is no
    rotation."""
    if not all(math.isfinite(value) for value in values):
        return None
    x, y, z = values[:3]
    length = math.hypot(*values[3:])
    if not length:
        return Transform((x, y, z))
    a, b, c, d = (value / length for value in values[3:])
    return Transform((x, y, z), (a, b, c, d))


COVARIANCE_VALUES = 36
HEADING_VARIANCE = 35


@dataclass(frozen=True)
class Deviation:
    """Standard deviations of a pose: of its position where it is worst, and of its angle about the z axis."""

    position_m: float
    heading_rad: float


def deviation(covariance: Sequence[float]) -> Deviation | None:
    """The deviation by a geometry_msgs/PoseWithCovariance: 6 x 6 by rows, of x, y, z and the angles about x, y, z.

    None when it says nothing: all zero, a negative variance (the sign of unknown in other messages), no numbers. The
    position's is exact for axes that do not vary together, otherwise at most too large (Gershgorin's bound)."""
    if len(covariance) != COVARIANCE_VALUES or not all(math.isfinite(value) for value in covariance):
        return None
    variances = covariance[0], covariance[7], covariance[14], covariance[HEADING_VARIANCE]
    if min(variances) < 0 or not any(variances):
        return None
    worst = max(sum(abs(value) for value in covariance[row : row + 3]) for row in (0, 6, 12))
    return Deviation(math.sqrt(worst), math.sqrt(covariance[HEADING_VARIANCE]))


@dataclass(frozen=True)
class InterpolatedPose:
    """The place of a frame at some time. `age_ns`: to the nearest of the messages it was made of; `span_ns`: between
    those two; `deviation`: the larger of theirs, None when not both say one."""

    transform: Transform
    age_ns: int
    span_ns: int
    deviation: Deviation | None = None


@dataclass
class PoseHistory:
    """Poses of one agent in `frame`, to be asked for any time between them."""

    frame: str = ""
    stamps: array[int] = field(default_factory=lambda: array("q"))
    poses: list[Transform] = field(default_factory=list)
    deviations: list[Deviation | None] = field(default_factory=list)

    def add(self, stamp: int, pose: Transform, deviation: Deviation | None = None) -> None:
        """Add a pose; what is not newer than the last one is put in its place, and the same stamp counts once."""
        place = bisect_right(self.stamps, stamp)
        if place and self.stamps[place - 1] == stamp:
            return
        self.stamps.insert(place, stamp)
        self.poses.insert(place, pose)
        self.deviations.insert(place, deviation)

    def at(self, stamp: int, gap_ns: int) -> InterpolatedPose | None:
        """The place at `stamp`: position linear, orientation on the great circle; None outside the poses and in gaps
        wider than `gap_ns`."""
        behind = bisect_right(self.stamps, stamp)
        if not behind:
            return None
        first = self.stamps[behind - 1]
        if first == stamp:
            return InterpolatedPose(self.poses[behind - 1], 0, 0, self.deviations[behind - 1])
        if behind == len(self.stamps) or (span := self.stamps[behind] - first) > gap_ns:
            return None
        share = (stamp - first) / span
        a, b = self.poses[behind - 1 : behind + 1]
        x, y, z = (p + (q - p) * share for p, q in zip(a.translation, b.translation, strict=True))
        mixed = Transform((x, y, z), slerp(a.rotation, b.rotation, share))
        worst = _larger(self.deviations[behind - 1], self.deviations[behind])
        return InterpolatedPose(mixed, min(stamp - first, self.stamps[behind] - stamp), span, worst)


@dataclass
class StaticTransforms:
    """Transforms that stay as they are: child frame -> (parent frame, transform)."""

    parents: dict[str, tuple[str, Transform]] = field(default_factory=dict)

    def add(self, parent: str, child: str, transform: Transform) -> None:
        """Set the transform of a child frame; the last one counts."""
        if parent != child:
            self.parents[child] = (parent, transform)

    def up_to(self, frame: str, roots: Sequence[str]) -> tuple[str, Transform] | None:
        """The first of `roots` on the way up from `frame`, and the transform from `frame` to it; None: no way."""
        joined = Transform()
        for _ in range(CHAIN_MAX):
            if frame in roots:
                return frame, joined
            if frame not in self.parents:
                return None
            frame, step = self.parents[frame]
            joined = step @ joined
        return None


def _larger(first: Deviation | None, second: Deviation | None) -> Deviation | None:
    if first is None or second is None:
        return None
    return Deviation(max(first.position_m, second.position_m), max(first.heading_rad, second.heading_rad))


def _rotated(rotation: Quaternion, point: Vector) -> Vector:
    qx, qy, qz, qw = rotation
    px, py, pz = point
    tx, ty, tz = 2 * (qy * pz - qz * py), 2 * (qz * px - qx * pz), 2 * (qx * py - qy * px)
    return (
        px + qw * tx + qy * tz - qz * ty,
        py + qw * ty + qz * tx - qx * tz,
        pz + qw * tz + qx * ty - qy * tx,
    )


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
