"""Guarantees of chart versions and requirements on them: numbers with units from a closed list.

A guarantee is `declared` until a guarantee suite measures it: no requirement with `verified: true` can be met yet.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.reader import Reader

DECLARED = "declared"
BOUNDS = ("atMost", "atLeast")
NUMBER_MAX = 1e300  # JSON knows numbers beyond what can be compared
UNITS: Mapping[str, tuple[str, float]] = {
    "ms": ("time", 0.001),
    "s": ("time", 1.0),
    "Hz": ("rate", 1.0),
    "m": ("length", 1.0),
    "m/s": ("speed", 1.0),
    "%": ("share", 1.0),
    "count": ("count", 1.0),
    "B": ("memory", 1.0),
    "KiB": ("memory", 1024.0),
    "MiB": ("memory", 1024.0**2),
    "GiB": ("memory", 1024.0**3),
    "mCPU": ("compute", 1.0),
}
"""Unit -> what it measures and its size in the base unit of that (s, Hz, m, m/s, %, count, B, mCPU)."""


@dataclass(frozen=True)
class Guarantee:
    """A guarantee of a chart version: `name` is at most or at least (`bound`) `number` `unit`."""

    name: str
    bound: str
    number: float
    unit: str
    description: str = ""

    @property
    def document(self) -> Mapping[str, Any]:
        """The guarantee as a document, with its status."""
        return {"name": self.name, self.bound: self.number, "unit": self.unit, "status": DECLARED}

    def __str__(self) -> str:
        return f"{_sentence(self)} ({DECLARED})"


@dataclass(frozen=True)
class GuaranteeRequirement:
    """What a service needs of its chart; `verified`: a declared guarantee is not enough."""

    name: str
    bound: str
    number: float
    unit: str
    verified: bool = False

    def __str__(self) -> str:
        return _sentence(self) + (" (verified)" if self.verified else "")


def shortfall(requirement: GuaranteeRequirement, guarantees: Sequence[Guarantee]) -> str:
    """Why `guarantees` do not meet the requirement; empty when they do."""
    guarantee = next((g for g in guarantees if g.name == requirement.name), None)
    if guarantee is None:
        return f"gives no guarantee {requirement.name}; wanted is {requirement}"
    if guarantee.bound != requirement.bound or UNITS[guarantee.unit][0] != UNITS[requirement.unit][0]:
        return f"guarantees {guarantee}, which cannot be compared with {requirement}"
    given, wanted = (side.number * UNITS[side.unit][1] for side in (guarantee, requirement))
    within = given <= wanted if requirement.bound == "atMost" else given >= wanted
    if not (within or math.isclose(given, wanted)):
        return f"guarantees {guarantee}, which is not enough for {requirement}"
    if requirement.verified:
        return f"guarantees {guarantee}, and {requirement} asks for a verified one; no suite verifies guarantees yet"
    return ""


def read_guarantees(reader: Reader, value: Any, path: str) -> tuple[Guarantee, ...]:
    """`[{name, atMost | atLeast, unit, description?}]`, names distinct."""
    guarantees: list[Guarantee] = []
    for index, item in enumerate(reader.sequence(value, path)):
        where = f"{path}[{index}]"
        document = reader.mapping(item, where, ["name", "unit"], [*BOUNDS, "description"])
        name = reader.word(document.get("name"), f"{where}.name", NAME)
        if name in {g.name for g in guarantees}:
            reader.problems.append(f"{where}.name: {name!r} stands twice; keep one of them")
        bound, number, unit = _quantity(reader, document, where)
        guarantees.append(Guarantee(name, bound, number, unit, reader.prose(document.get("description", ""), where)))
    return tuple(guarantees)


def read_requirements(reader: Reader, value: Any, path: str) -> tuple[GuaranteeRequirement, ...]:
    """`[{guarantee, atMost | atLeast, unit, verified?}]`."""
    requirements: list[GuaranteeRequirement] = []
    for index, item in enumerate(reader.sequence(value, path)):
        where = f"{path}[{index}]"
        document = reader.mapping(item, where, ["guarantee", "unit"], [*BOUNDS, "verified"])
        name = reader.word(document.get("guarantee"), f"{where}.guarantee", NAME)
        verified = document.get("verified", False)
        if not isinstance(verified, bool):
            reader.problems.append(f"{where}.verified: must be true or false")
        requirements.append(GuaranteeRequirement(name, *_quantity(reader, document, where), verified is True))
    return tuple(requirements)


def _quantity(reader: Reader, document: Mapping[str, Any], where: str) -> tuple[str, float, str]:
    bounds = [bound for bound in BOUNDS if bound in document]
    if len(bounds) != 1:
        reader.problems.append(f"{where}: needs exactly one of {', '.join(BOUNDS)}")
    bound = bounds[0] if bounds else BOUNDS[0]
    number = document.get(bound, 0)
    unit = document.get("unit")
    if isinstance(number, bool) or not isinstance(number, (int, float)) or not abs(number) <= NUMBER_MAX:
        reader.problems.append(f"{where}.{bound}: must be a number")
        number = 0
    if not isinstance(unit, str) or unit not in UNITS:
        reader.problems.append(f"{where}.unit: {unit!r:.40} is no unit; use one of {' '.join(UNITS)}")
        unit = "count"
    return bound, number, unit


def _sentence(side: Guarantee | GuaranteeRequirement) -> str:
    words = "at most" if side.bound == "atMost" else "at least"
    return f"{side.name} {words} {side.number:g} {side.unit}"
