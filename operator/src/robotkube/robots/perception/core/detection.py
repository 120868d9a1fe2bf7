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
from itertools import pairwise

from robotkube.robots.perception.core.messages import PlanarPose
from robotkube.robots.perception.core.point_clouds import Cloud

SIZE = "size"
REFLECTANCE = "reflectance"
METHODS = (SIZE, REFLECTANCE)
GROUND_CLEARANCE_M = 0.3
HEIGHT_MAX_M = 5.0  # above that is no vehicle
GROUND_STEP_M = 0.2
GROUND_SAMPLES = 2000
CELL_M = {SIZE: 0.5, REFLECTANCE: 1.0}  # far away the lines of a roof are metres apart
LINKED_CELLS = 4  # clusters are farther apart than this
SEEN_GAP_M = 0.4  # seen between two vehicles when the inner side of one is seen, too
SEEN_GAP_RADIANS = 0.015  # more than between two columns of points
SPLIT_CELL_M = 0.5  # vehicles beside each other are, at the latest, with cells this large
SPLIT_CELLS = (6, 5, 4, 3, 2, 1)  # and over ways of 3 m, 2.5 m, ... 0.5 m between their cells
SPLIT_EXTENT_M = 13.0  # three beside each other, or two behind each other
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


Fit = tuple[DetectedObject, Sequence[Point]]
"""A box, and the points that it was fitted to."""


def find_objects(cloud: Cloud, criteria: ObjectCriteria) -> tuple[DetectedObject, ...]:
    """The vehicles in the cloud, nearest first."""
    clusters = _clusters(_candidates(cloud, criteria), CELL_M[criteria.method], LINKED_CELLS)
    boxes = (box for cluster in clusters for box in _boxes(cluster, criteria))
    within = [box for box in boxes if math.hypot(box.pose.x, box.pose.y) <= criteria.range_m]
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
    top = floor + HEIGHT_MAX_M
    if criteria.method == REFLECTANCE:
        bright = criteria.reflectance_min
        heights = cloud.z
        above = [n for n, share in enumerate(cloud.intensity) if share >= bright and floor < heights[n] < top]
    else:
        above = [index for index, z in enumerate(cloud.z) if floor < z < top]
    points = ((cloud.x[index], cloud.y[index], cloud.z[index]) for index in above)
    return [point for point in points if point[0] * point[0] + point[1] * point[1] <= reach]


def _ground(cloud: Cloud) -> float:
    """Height of the ground in the sensor's frame: the height that most points have."""
    sample = cloud.z[:: max(1, len(cloud.z) // GROUND_SAMPLES)]
    [(level, _)] = Counter(round(z / GROUND_STEP_M) for z in sample if math.isfinite(z)).most_common(1) or [(0, 0)]
    return level * GROUND_STEP_M


def _boxes(cluster: Sequence[Point], criteria: ObjectCriteria) -> Iterator[DetectedObject]:
    """The vehicles in a cluster. Vehicles beside each other may be in one: it is taken apart where the sensor sees
    between them. What is larger than a few vehicles stays what it is, and is none."""
    extent = _extent(cluster)
    if len(cluster) < criteria.points_min or extent > SPLIT_EXTENT_M:
        return
    parts = _seen_apart(cluster) if extent > criteria.width_m + SEEN_GAP_M else [cluster]
    yield from _whole([fit for part in parts for fit in _fitted_or_split(part, criteria, SPLIT_CELLS)], criteria)


def _whole(fits: Sequence[Fit], criteria: ObjectCriteria) -> Iterator[DetectedObject]:
    """The vehicles without those that are pieces of another one: lines of a roof that were taken apart from it lie in
    its box."""
    kept: list[DetectedObject] = []
    for box, part in sorted(fits, key=lambda one: -len(one[1])):
        if not any(_lies_in(other, part, criteria) for other in kept):
            kept.append(box)
            yield box


def _lies_in(box: DetectedObject, part: Sequence[Point], criteria: ObjectCriteria) -> bool:
    """Return whether most of the points are in the box, or as near to it as its own may be."""
    sine = 2 * box.pose.quaternion_z * box.pose.quaternion_w
    cosine = 1 - 2 * box.pose.quaternion_z**2
    length, width = ((size + SIZE_TOLERANCE_M) / 2 for size in (criteria.length_m, criteria.width_m))
    offsets = [(point[0] - box.pose.x, point[1] - box.pose.y) for point in part]
    inside = sum(abs(cosine * x + sine * y) <= length and abs(cosine * y - sine * x) <= width for x, y in offsets)
    return 2 * inside > len(part)


def _fitted_or_split(cluster: Sequence[Point], criteria: ObjectCriteria, split_cells: Sequence[int]) -> Iterator[Fit]:
    """The vehicle that a cluster is; when it is too large, those in it, which is taken apart over ever shorter ways, as
    few as are needed."""
    longest = math.hypot(criteria.length_m + SIZE_TOLERANCE_M, criteria.width_m + SIZE_TOLERANCE_M)
    box = _fitted(cluster, criteria) if _extent(cluster) <= longest else None
    if box:
        yield box, cluster
    elif len(cluster) >= 2 * criteria.points_min and _falls_apart(cluster):
        for number, cells in enumerate(split_cells, 1):
            parts = list(_clusters(cluster, SPLIT_CELL_M, cells))
            if len(parts) > 1:
                for part in parts:
                    yield from _fitted_or_split(part, criteria, split_cells[number:])
                return


def _falls_apart(cluster: Sequence[Point]) -> bool:
    """Return whether the shortest way takes it apart; a wall's is whole, whatever is tried."""
    parts = _clusters(cluster, SPLIT_CELL_M, SPLIT_CELLS[-1])
    return len(next(parts)) < len(cluster)


def _seen_apart(cluster: Sequence[Point]) -> list[Sequence[Point]]:
    """The parts of a cluster between which nothing is in the directions that the sensor looks to. Along these its
    points are close together; away from it the lines of a roof are metres apart."""
    x, y, _ = cluster[0]
    turned = sorted((math.atan2(x * q - y * p, x * p + y * q), n) for n, (p, q, _) in enumerate(cluster))
    nearest = math.sqrt(min(p * p + q * q for p, q, _ in cluster))
    angle_min = SEEN_GAP_M / max(nearest, SEEN_GAP_M) + SEEN_GAP_RADIANS
    begins = [n for n, (before, after) in enumerate(pairwise(turned), 1) if after[0] - before[0] > angle_min]
    bounds = [0, *begins, len(turned)]
    return [[cluster[n] for _, n in turned[first:last]] for first, last in pairwise(bounds)]


def _extent(cluster: Sequence[Point]) -> float:
    """The longer one of the sides along the axes."""
    columns = [[point[axis] for point in cluster] for axis in (0, 1)]
    return max(max(column) - min(column) for column in columns)


def _clusters(points: Sequence[Point], cell_m: float, linked_cells: int) -> Iterator[list[Point]]:
    """Clusters of points whose cells are linked over short ways."""
    reach = range(-linked_cells, linked_cells + 1)
    ways = [(column, row) for column in reach for row in reach]
    cells: dict[tuple[int, int], list[Point]] = {}
    for point in points:
        cells.setdefault((math.floor(point[0] / cell_m), math.floor(point[1] / cell_m)), []).append(point)
    while cells:
        first, members = cells.popitem()
        waiting = deque([first])
        cluster = list(members)
        while waiting:
            column, row = waiting.popleft()
            for cell in [(column + columns, row + rows) for columns, rows in ways]:
                if cell in cells:
                    cluster += cells.pop(cell)
                    waiting.append(cell)
        yield cluster


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
    cosine = math.cos(rectangle.yaw)
    sine = math.sin(rectangle.yaw)
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
    cosine = math.cos(yaw)
    sine = math.sin(yaw)
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
