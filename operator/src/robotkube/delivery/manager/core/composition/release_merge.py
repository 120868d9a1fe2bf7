"""Merging of releases that several demands ask for: equal but for some lists, whose items are put together."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from robotkube.delivery.deployment.core.releases import Release


def merged_release(first: Release, second: Release, paths: Sequence[str]) -> Release | None:
    """Both releases as one, or None when they differ in more than the lists at `paths` (keys joined by dots).

    A merged list holds every item once, sorted by its JSON text, so that the order of demands does not matter."""
    if not paths or replace(first, values={}) != replace(second, values={}):
        return None
    try:
        return replace(first, values=_merged(first.values, second.values, frozenset(paths), ""))
    except _DifferentError:
        return None


class _DifferentError(Exception):
    """Two values differ where nothing may be merged."""


def _merged(first: Any, second: Any, paths: frozenset[str], path: str) -> Any:
    if path in paths and isinstance(first, list) and isinstance(second, list):
        items = {json.dumps(item, sort_keys=True): item for item in [*first, *second]}
        return [items[text] for text in sorted(items)]
    if isinstance(first, Mapping) and isinstance(second, Mapping) and first.keys() == second.keys():
        return {key: _merged(first[key], second[key], paths, f"{path}.{key}" if path else key) for key in first}
    if first != second:
        raise _DifferentError
    return first
