"""Areas of the plane: a strict reader of GeoJSON's Polygon and MultiPolygon, and tests of points against them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from robotkube.foundation.documents.core.reader import MappingReader
from robotkube.robots.rules.core.specification.specifications import Point, Ring

CORNERS_MAX = 1000
COORDINATE_MAX = 1e9

ROUNDING = 1e-9
"""The relative error of a product: corners so near a straight line are on it."""

Polygon = tuple[Ring, ...]
RingSegment = tuple[Point, Point]


class AreaError(ValueError):
    """A fault in coordinates, as the end of a sentence that begins with the key."""


def read_area(item: MappingReader) -> tuple[Polygon, ...]:
    """Read `{type: Polygon | MultiPolygon, coordinates: ...}`; problems go to the reader's list."""
    kind = item.choice("type", ("Polygon", "MultiPolygon"))
    coordinates = item.value("coordinates")
    item.refuse_unknown_keys()
    try:
        polygons = tuple(_polygon(entry) for entry in _list(coordinates if kind == "MultiPolygon" else [coordinates]))
        corners = sum(len(ring) for polygon in polygons for ring in polygon)
        if corners > CORNERS_MAX:
            raise AreaError(f"must hold at most {CORNERS_MAX} corners, not {corners}")
    except AreaError as error:
        item.problem("coordinates", str(error))
        return ()
    return polygons


def _list(value: Any) -> Sequence[Any]:
    if not isinstance(value, list) or not value:
        raise AreaError("must be lists of rings as in GeoJSON: the outer ring first, then the holes")
    return value


def _polygon(value: Any) -> Polygon:
    return tuple(_ring(ring) for ring in _list(value))


def _ring(value: Any) -> Ring:
    points = [_point(entry) for entry in _list(value)]
    if len(points) > 1 and points[0] == points[-1]:
        points.pop()
    if len(points) < 3 or not _extent(points):
        raise AreaError("must hold rings of at least three corners that enclose something")
    if crossing := _intersection(tuple(points)):
        (start, _), (other, _) = crossing
        raise AreaError(
            f"must hold rings that do not cross themselves; the edge from {_point_text(start)} crosses that from "
            f"{_point_text(other)}: list the corners in the order in which one walks around"
        )
    return tuple(points)


def _point_text(point: Point) -> str:
    return f"[{point[0]:g}, {point[1]:g}]"


def _intersection(ring: Ring) -> tuple[RingSegment, RingSegment] | None:
    """Two edges that go through each other; edges that only touch do not. Only those that overlap in x are compared."""
    ordered = sorted(_segments(ring), key=lambda segment: min(segment[0][0], segment[1][0]))
    open_segments: list[RingSegment] = []
    for segment in ordered:
        left = min(segment[0][0], segment[1][0])
        open_segments = [other for other in open_segments if max(other[0][0], other[1][0]) > left]
        for other in open_segments:
            if _cross(*segment, *other):
                return other, segment
        open_segments.append(segment)
    return None


def _cross(a: Point, b: Point, c: Point, d: Point) -> bool:
    return _turn(a, b, c) * _turn(a, b, d) < 0 and _turn(c, d, a) * _turn(c, d, b) < 0


def _turn(a: Point, b: Point, c: Point) -> int:
    """The turn at `b`: 1 to the left, -1 to the right, 0 straight on."""
    left = (b[0] - a[0]) * (c[1] - a[1])
    right = (b[1] - a[1]) * (c[0] - a[0])
    close = abs(left - right) <= ROUNDING * (abs(left) + abs(right))
    return 0 if close else 1 if left > right else -1


def _point(value: Any) -> Point:
    numbers = isinstance(value, list) and 2 <= len(value) <= 3
    if not numbers or not all(isinstance(part, (int, float)) and not isinstance(part, bool) for part in value):
        raise AreaError("must hold corners as lists [x, y] of two numbers")
    if not all(abs(part) <= COORDINATE_MAX for part in value):
        raise AreaError(f"must hold numbers from {-COORDINATE_MAX:g} to {COORDINATE_MAX:g}")
    return float(value[0]), float(value[1])


def _extent(points: Sequence[Point]) -> bool:
    (x0, y0) = points[0]
    rest = points[1:]
    return any((x1 - x0) * (y2 - y0) != (x2 - x0) * (y1 - y0) for (x1, y1), (x2, y2) in pairwise(rest))


class Area:
    """Polygons prepared for many points. A point on an outer ring or on a hole's ring is within."""

    def __init__(self, polygons: Sequence[Polygon]) -> None:
        self._polygons = [(polygon, _box(polygon[0])) for polygon in polygons]
        self._segments = [segment for polygon in polygons for ring in polygon for segment in _segments(ring)]

    def contains(self, x: float, y: float) -> bool:
        """Return whether the point lies within."""
        return any(
            left <= x <= right and low <= y <= high and _within(polygon, x, y)
            for polygon, (left, low, right, high) in self._polygons
        )

    def distance(self, x: float, y: float) -> float:
        """The distance to the nearest point of any ring, in the coordinates' unit."""
        return min(_to_edge(x, y, *start, *end) for start, end in self._segments)


def _segments(ring: Ring) -> Sequence[RingSegment]:
    return list(zip(ring, (*ring[1:], ring[0]), strict=True))


def _box(ring: Ring) -> tuple[float, float, float, float]:
    xs = [x for x, _ in ring]
    ys = [y for _, y in ring]
    return min(xs), min(ys), max(xs), max(ys)


def _within(polygon: Polygon, x: float, y: float) -> bool:
    outer = _side(polygon[0], x, y)
    return outer >= 0 and all(_side(hole, x, y) <= 0 for hole in polygon[1:])


def _side(ring: Ring, x: float, y: float) -> int:
    """The side of a point: 1 within, 0 on the ring, -1 outside; by the number of edges that a ray to the right
    crosses."""
    inside = False
    x1, y1 = ring[-1]
    for x2, y2 in ring:
        cross = (x2 - x1) * (y - y1) - (x - x1) * (y2 - y1)
        if cross == 0 and min(x1, x2) <= x <= max(x1, x2) and min(y1, y2) <= y <= max(y1, y2):
            return 0
        if (y1 > y) != (y2 > y) and (cross > 0) == (y2 > y1):
            inside = not inside
        x1, y1 = x2, y2
    return 1 if inside else -1


def _to_edge(x: float, y: float, x1: float, y1: float, x2: float, y2: float) -> float:
    dx, dy = x2 - x1, y2 - y1
    length = dx * dx + dy * dy
    share = 0.0 if length == 0 else max(0.0, min(1.0, ((x - x1) * dx + (y - y1) * dy) / length))
    return math.hypot(x - x1 - share * dx, y - y1 - share * dy)
