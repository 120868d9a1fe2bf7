"""Rotations as quaternions, and interpolation between two of them."""

from __future__ import annotations

import math
from collections.abc import Sequence

Quaternion = tuple[float, float, float, float]


def slerp(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    """The rotation at `share` (0 to 1) of the shorter way from `a` to `b`; both of length 1, as the result."""
    cosine = sum(p * q for p, q in zip(a, b, strict=True))
    if cosine < 0:
        b = (-b[0], -b[1], -b[2], -b[3])
        cosine = -cosine
    if cosine > 0.9995:  # nearly the same: the sine would vanish, and the straight way is as good
        return _unit([p + (q - p) * share for p, q in zip(a, b, strict=True)])
    angle = math.acos(cosine)
    weight_a, weight_b = math.sin((1 - share) * angle) / math.sin(angle), math.sin(share * angle) / math.sin(angle)
    return _unit([p * weight_a + q * weight_b for p, q in zip(a, b, strict=True)])


def _unit(values: Sequence[float]) -> Quaternion:
    length = math.hypot(*values)
    if not length or not math.isfinite(length):
        return 0.0, 0.0, 0.0, 1.0
    x, y, z, w = (value / length for value in values)
    return x, y, z, w
