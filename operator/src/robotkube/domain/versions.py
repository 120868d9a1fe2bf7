"""Versions of charts: their order, and ranges as comparators (`>=0.1.0 <0.2.0`, all must hold)."""

from __future__ import annotations

import re

_COMPARATOR = re.compile(r"(>=|<=|>|<|=)(\d{1,9}\.\d{1,9}\.\d{1,9}(?:-[0-9A-Za-z.-]{1,64})?)", re.ASCII)


def version_key(version: str) -> tuple[int, int, int, bool, str]:
    """Sorts versions; a pre-release comes before its release."""
    core, _, pre = version.partition("-")
    major, minor, patch = (int(part) for part in core.split("."))
    return major, minor, patch, not pre, pre


def is_range(text: str) -> bool:
    """Whether `text` is one or more comparators separated by spaces."""
    return bool(text.split()) and all(_COMPARATOR.fullmatch(part) for part in text.split())


def in_range(version: str, requirement: str) -> bool:
    """Whether every comparator of `requirement` holds; an empty requirement takes every version."""
    key = version_key(version)
    for comparator in requirement.split():
        match = _COMPARATOR.fullmatch(comparator)
        if match is None:
            return False
        bound = version_key(match[2])
        holds = {">=": key >= bound, "<=": key <= bound, ">": key > bound, "<": key < bound, "=": key == bound}
        if not holds[match[1]]:
            return False
    return True
