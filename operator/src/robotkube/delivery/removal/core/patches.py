"""Patches that only take away: what JSON pointers (RFC 6901) name in a workload, as a JSON patch (RFC 6902).

The pointers are those of one generation of one object. The patch holds for the version of it that was read, and for no
other one: the API server refuses it as a conflict when anything was changed meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.delivery.removal.core.targets import WorkloadTarget

PLACES = (("metadata", "annotations"), ("metadata", "labels"), ("spec",))
"""Where something may be taken away: below these."""

Object = Mapping[str, Any]
Patch = list[dict[str, Any]]
Path = tuple[str | int, ...]


def restoring_patch(document: Object, target: WorkloadTarget) -> Patch | str:
    """The patch that takes the target's excess out of `document`; empty when nothing of it is there any more. A text
    says why there is none: what was read is not what was compared."""
    metadata = document["metadata"]
    if metadata.get("uid") != target.uid:
        return "it was made anew since it was looked at"
    if metadata.get("generation") != target.generation:
        return "it was changed since it was looked at"
    paths = {path for pointer in target.excess if (path := _path(document, pointer)) is not None}
    tops = [path for path in paths if not any(path[:length] in paths for length in range(1, len(path)))]
    removals = [{"op": "remove", "path": _pointer(path)} for path in sorted(tops, key=_order, reverse=True)]
    version = {"op": "replace", "path": "/metadata/resourceVersion", "value": metadata["resourceVersion"]}
    return [version, *removals] if removals else []


def _path(document: Object, pointer: str) -> Path | None:
    """The pointer's steps in the document; None when it leads nowhere, or to where nothing may be taken away."""
    place: Any = document
    steps: list[str | int] = []
    for word in pointer.split("/")[1:]:
        step = _step(place, word.replace("~1", "/").replace("~0", "~"))
        if step is None:
            return None
        steps.append(step)
        place = place[step]
    below = any(tuple(steps[: len(head)]) == head and len(steps) > len(head) for head in PLACES)
    return tuple(steps) if below else None


def _step(place: Any, word: str) -> str | int | None:
    if isinstance(place, Mapping):
        return word if word in place else None
    if isinstance(place, Sequence) and not isinstance(place, str) and word.isdecimal() and int(word) < len(place):
        return int(word)
    return None


def _order(path: Path) -> tuple[tuple[int, str], ...]:
    """Sorted downwards, later entries of a list go before earlier ones, whose numbers so stay what they are."""
    return tuple((step, "") if isinstance(step, int) else (-1, step) for step in path)


def _pointer(path: Path) -> str:
    return "".join("/" + str(step).replace("~", "~0").replace("/", "~1") for step in path)
