"""Quantities as Kubernetes writes them: 30m of a core, 64Mi of memory; the one place that reads them.

Kubernetes takes more forms than people are asked to write: CPU and MEMORY are theirs.
"""

from __future__ import annotations

import re
from decimal import Decimal, InvalidOperation
from typing import Any

UNITS = {
    "": Decimal(1),
    "m": Decimal("0.001"),
    **{unit: Decimal(1000) ** power for power, unit in enumerate(("k", "M", "G", "T"), 1)},
    **{unit: Decimal(1024) ** power for power, unit in enumerate(("Ki", "Mi", "Gi", "Ti"), 1)},
}
QUANTITY = re.compile(r"([0-9]+(?:\.[0-9]+)?)([A-Za-z]*)", re.ASCII)
CPU = re.compile(r"[0-9]{1,6}(\.[0-9]{1,3})?|[0-9]{1,9}m", re.ASCII)
MEMORY = re.compile(r"[0-9]{1,9}(Ki|Mi|Gi)", re.ASCII)


def quantity(value: Any) -> Decimal | None:
    """The number (cores, bytes) that a Kubernetes quantity stands for; None when it is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    match = QUANTITY.fullmatch(str(value))
    if not match or match[2] not in UNITS:
        return None
    try:
        return Decimal(match[1]) * UNITS[match[2]]
    except InvalidOperation:
        return None


def quantity_of_form(value: Any, form: re.Pattern[str]) -> Decimal | None:
    """The number that a quantity stands for; None when it is not of this form (CPU or MEMORY)."""
    return quantity(value) if form.fullmatch(str(value)) else None


def written(amount: Decimal, name: str) -> str:
    """An amount of `cpu` (cores) or `memory` (bytes) as a chart writes it."""
    if name == "cpu":
        return f"{(amount * 1000).normalize():f}m"
    return f"{(amount / UNITS['Mi']).normalize():f}Mi"
