"""Excess: where in a workload something stands that its release's chart does not render, and so has to go.

Only what was added: a value that the chart has otherwise is seen by Argo CD, which puts it back.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from robotkube.delivery.inspection.core.comparison import is_explained

EXCESS_MAX = 50
KEYS = ("mountPath", "devicePath", "containerPort", "name", "ip", "key", "topologyKey")
"""By the first of these that they have, entries of a list are told apart (the API's merge keys)."""

Object = Mapping[str, Any]


def excess(live: Object, versions: Iterable[Object]) -> tuple[str, ...]:
    """JSON pointers (RFC 6901) into the workload `live`, none below another, at most EXCESS_MAX: what none of the
    chart's `versions` has, today's and those that are being replaced."""
    added = [dict.fromkeys(_of_version(live, rendered)) for rendered in versions]
    common = [pointer for pointer in (added[0] if added else ()) if all(_is_in(pointer, other) for other in added)]
    return tuple(common[:EXCESS_MAX])


def _is_in(pointer: str, pointers: Iterable[str]) -> bool:
    return any(pointer == one or pointer.startswith(f"{one}/") for one in pointers)


def _of_version(live: Object, rendered: Object) -> Iterator[str]:
    for part in ("labels", "annotations"):
        have, has = ((one.get("metadata") or {}).get(part) or {} for one in (live, rendered))
        yield from _in_mapping(have, has, f"metadata.{part}", f"/metadata/{part}")
    yield from _in_mapping(live.get("spec") or {}, rendered.get("spec") or {}, "spec", "/spec")


def _in(live: Any, rendered: Any, place: str, pointer: str) -> Iterator[str]:
    if isinstance(live, Mapping) and isinstance(rendered, Mapping):
        yield from _in_mapping(live, rendered, place, pointer)
    elif isinstance(live, list) and isinstance(rendered, list):
        yield from _in_list(live, rendered, place, pointer)


def _in_mapping(live: Object, rendered: Object, place: str, pointer: str) -> Iterator[str]:
    for key, value in live.items():
        inner = f"{pointer}/{str(key).replace('~', '~0').replace('/', '~1')}"
        if key in rendered:
            yield from _in(value, rendered[key], f"{place}.{key}", inner)
        elif not is_explained(live, key, f"{place}.{key}"):
            yield inner


def _in_list(live: list[Any], rendered: list[Any], place: str, pointer: str) -> Iterator[str]:
    """Entries that the chart does not have, by their keys. A list of words or of entries without keys is one value."""
    keys = [_key(entry) for entry in live]
    known = [_key(entry) for entry in rendered]
    if None in keys or None in known:
        return
    for index, (key, entry) in enumerate(zip(keys, live, strict=True)):
        own = [other for one, other in zip(known, rendered, strict=True) if one == key]
        same = [number for number, one in enumerate(keys) if one == key]
        alike = [number for number in same if live[number] in own]
        kept = sorted([*alike, *(number for number in same if number not in alike)][: len(own)])
        if index not in kept:
            yield f"{pointer}/{index}"
        else:
            yield from _in(entry, own[kept.index(index)], f"{place}.*", f"{pointer}/{index}")


def _key(entry: Any) -> tuple[str, ...] | None:
    if not isinstance(entry, Mapping):
        return None
    name = next((name for name in KEYS if name in entry), "")
    return (name, str(entry[name]), str(entry.get("protocol", "TCP"))) if name else None
