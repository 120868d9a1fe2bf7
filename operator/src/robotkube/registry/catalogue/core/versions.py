"""Versions of charts: their order, which is that of Semantic Versioning 2.0.0, and ranges as comparators
(`>=0.1.0 <0.2.0`, all must hold)."""

from __future__ import annotations

import operator
import re
from functools import lru_cache

from semver import Version

from robotkube.foundation.documents.core.patterns import DOCUMENTS_CACHED_MAX, VERSION

Precedence = tuple[int, int, int, bool, tuple[tuple[bool, int, str], ...]]
LOWEST = "0.0.0-0"  # no version comes before this one

_COMPARATOR = re.compile(rf"(>=|<=|>|<|=)({VERSION.pattern})")
_HOLDS = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt, "=": operator.eq}


@lru_cache(DOCUMENTS_CACHED_MAX)
def version_key(version: str) -> Precedence:
    """Sorts versions by precedence (item 11 of the specification); ValueError when `version` is none.

    A tuple, since decisions sort and compare hundreds of versions; semver's own objects take forty times as long."""
    read = Version.parse(version)
    parts = read.prerelease.split(".") if read.prerelease else []
    return read.major, read.minor, read.patch, not parts, tuple(_identifier(part) for part in parts)


def is_range(text: str) -> bool:
    """Return whether `text` is one or more comparators separated by spaces."""
    return bool(text.split()) and all(_COMPARATOR.fullmatch(part) for part in text.split())


def in_range(version: str, requirement: str) -> bool:
    """Return whether every comparator of `requirement` holds; an empty requirement allows every version."""
    matches = [_COMPARATOR.fullmatch(comparator) for comparator in requirement.split()]
    return all(match and _HOLDS[match[1]](version_key(version), version_key(match[2])) for match in matches)


def _identifier(part: str) -> tuple[bool, int, str]:
    """Numbers come before words, and are compared as numbers."""
    return (False, int(part), "") if part.isdigit() else (True, 0, part)
