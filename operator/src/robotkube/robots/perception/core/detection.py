"""Vehicles in a lidar cloud: points above the ground -> clusters -> boxes of a known size. Lengths in m.

Two methods. `size`: everything above the ground is clustered, and what is as large as a vehicle is one; walls that the
range cuts off look like that, so it does not look far. `reflectance`: only points that reflect like a vehicle count,
so the range may be large and few points are enough.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from robotkube.robots.perception.core.messages import Cloud, PlanarPose

SIZE = "size"
REFLECTANCE = "reflectance"
METHODS = (SIZE, REFLECTANCE)
GROUND_CLEARANCE_M = 0.3
HEIGHT_MAX_M = 5.0  # above that is no vehicle
GROUND_STEP_M = 0.2
GROUND_SAMPLES = 2000
CELL_M = {SIZE: 0.5, REFLECTANCE: 1.0}  # far away the lines of a roof are metres apart
LINKED_CELLS = 4  # clusters are farther apart than this
MARGIN_M = 8.0  # clustered beyond the range, so that nothing long looks short at its edge
SIZE_TOLERANCE_M = 1.0
FACE_TOLERANCE_M = 0.4
FIT_POINTS_MAX = 300
FIT_STEP_DEGREES = 5

Point = tuple[float, float, float]


@dataclass(frozen=True)
class ObjectCriteria:
    """The criteria of a vehicle: its length and width, least number of points, and the greatest distance."""

    method: str
    range_m: float
    reflectance_min: float = 0.7
    length_m: float = 4.6
    width_m: float = 1.9
    points_min: int = 4


@dataclass(frozen=True)
class DetectedObject:
    """A detected box: the pose of its centre, and the number of points by which it is known."""

    pose: PlanarPose
    points: int

    @property
    def uncertainty(self) -> float:
        """Relative standard error of a mean over the points: 0.5 for 4, 0.1 for 100."""
        return 1 / math.sqrt(self.points)


def find_objects(cloud: Cloud, criteria: ObjectCriteria) -> tuple[DetectedObject, ...]:
    """The vehicles in the cloud, nearest first."""
    boxes = (_fitted(cluster, criteria) for cluster in _clusters(_candidates(cloud, criteria), CELL_M[criteria.method]))
    within = [box for box in boxes if box and math.hypot(box.pose.x, box.pose.y) <= criteria.range_m]
    return tuple(sorted(within, key=lambda box: math.hypot(box.pose.x, box.pose.y)))


def uncertainty(objects: Sequence[DetectedObject]) -> float:
    """The largest uncertainty of all objects; 0 when there is none."""
    return max((detected.uncertainty for detected in objects), default=0.0)


def _candidates(cloud: Cloud, criteria: ObjectCriteria) -> list[Point]:
    """Points above the ground that may belong to a vehicle."""
    if not cloud.z:
        return []
    floor = _ground(cloud) + GROUND_CLEARANCE_M
    reach = (criteria.range_m + MARGIN_M) ** 2
    above = [index for index, z in enumerate(cloud.z) if floor < z < floor + HEIGHT_MAX_M]
    if criteria.method == REFLECTANCE:
        bright = criteria.reflectance_min
        intensity = cloud.intensity
        above = [index for index in above if intensity[index] >= bright] if intensity else []
    points = ((cloud.x[index], cloud.y[index], cloud.z[index]) for index in above)
    return [point for point in points if point[0] * point[0] + point[1] * point[1] <= reach]


def _ground(cloud: Cloud) -> float:
    """Height of the ground in the sensor's frame: the height that most points have."""
    sample = cloud.z[:: max(1, len(cloud.z) // GROUND_SAMPLES)]
    [(level, _)] = Counter(round(z / GROUND_STEP_M) for z in sample if math.isfinite(z)).most_common(1) or [(0, 0)]
    return level * GROUND_STEP_M


def _clusters(points: Sequence[Point], cell_m: float) -> Iterator[list[Point]]:
    """Clusters of points whose cells are linked over short ways."""
    cells: dict[tuple[int, int], list[Point]] = {}
    for point in points:
        cells.setdefault((math.floor(point[0] / cell_m), math.floor(point[1] / cell_m)), []).append(point)
    while cells:
        first, members = cells.popitem()
        waiting = deque([first])
        cluster = list(members)
        while waiting:
            for cell in _near(waiting.popleft()):
                if cell in cells:
                    cluster += cells.pop(cell)
                    waiting.append(cell)
        yield cluster


def _near(cell: tuple[int, int]) -> Iterator[tuple[int, int]]:
    reach = range(-LINKED_CELLS, LINKED_CELLS + 1)
    return ((cell[0] + column, cell[1] + row) for column in reach for row in reach)


@dataclass(frozen=True)
class _Rectangle:
    """Bounds of a cluster along two axes, the first turned by `yaw`."""

    yaw: float
    low: tuple[float, float]
    high: tuple[float, float]

    @property
    def extents(self) -> tuple[float, float]:
        return self.high[0] - self.low[0], self.high[1] - self.low[1]


def _fitted(cluster: Sequence[Point], criteria: ObjectCriteria) -> DetectedObject | None:
    """The box of known size behind the faces that are seen; None when the cluster is too small or too large."""
    if len(cluster) < criteria.points_min:
        return None
    rectangle = _smallest_rectangle(cluster)
    longer = max(rectangle.extents)
    if longer > criteria.length_m + SIZE_TOLERANCE_M or min(rectangle.extents) > criteria.width_m + SIZE_TOLERANCE_M:
        return None
    # Seen is a side when it is longer than the width, else a front or a back, behind which the length lies.
    first_is_longer = rectangle.extents[0] >= rectangle.extents[1]
    lengthwise = first_is_longer == (longer > criteria.width_m + FACE_TOLERANCE_M)
    sizes = (criteria.length_m, criteria.width_m) if lengthwise else (criteria.width_m, criteria.length_m)
    along, across = (_centre(rectangle.low[axis], rectangle.high[axis], sizes[axis]) for axis in (0, 1))
    cosine, sine = math.cos(rectangle.yaw), math.sin(rectangle.yaw)
    heading = rectangle.yaw if lengthwise else rectangle.yaw + math.pi / 2
    z = (min(point[2] for point in cluster) + max(point[2] for point in cluster)) / 2
    x, y = cosine * along - sine * across, sine * along + cosine * across
    return DetectedObject(PlanarPose(x, y, z, math.sin(heading / 2), math.cos(heading / 2)), len(cluster))


def _smallest_rectangle(cluster: Sequence[Point]) -> _Rectangle:
    """The rectangle of the least area; of two alike the one with the shorter outline."""
    points = cluster[:: math.ceil(len(cluster) / FIT_POINTS_MAX)]
    turned = (_bounds(points, math.radians(degrees)) for degrees in range(0, 90, FIT_STEP_DEGREES))
    return min(turned, key=lambda r: (round(r.extents[0] * r.extents[1], 2), sum(r.extents)))


def _bounds(points: Sequence[Point], yaw: float) -> _Rectangle:
    cosine, sine = math.cos(yaw), math.sin(yaw)
    along = [cosine * x + sine * y for x, y, _ in points]
    across = [cosine * y - sine * x for x, y, _ in points]
    return _Rectangle(yaw, (min(along), min(across)), (max(along), max(across)))


def _centre(low: float, high: float, size: float) -> float:
    """Middle of a side of `size` of which low..high is seen from 0: the near end is seen, the far one may be hidden."""
    if low > 0:
        return low + size / 2
    if high < 0:
        return high - size / 2
    return (low + high) / 2
