"""What a plan changes in its releases, value by value, for people: a record of a plan that is read beside the files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.plans import Change

VALUES_MAX = 40
"""So many values of a plan are told, the rest is counted."""
TEXT_CHARACTERS_MAX = 160


@dataclass(frozen=True)
class ValueDifference:
    """One value of a release: its path in the chart's values (`detector.topics[0].depth`; `chart`, `version` for the
    chart itself) and its JSON text before and after, None where it is not there."""

    release: str
    path: str
    before: str | None
    after: str | None


@dataclass(frozen=True)
class ReleaseDifferences:
    """The values that a plan changes, the first VALUES_MAX of them; `more`: how many were left out."""

    values: tuple[ValueDifference, ...] = ()
    more: int = 0

    def as_json(self) -> dict[str, Any]:
        """The differences in the form of GET /plans."""
        return {"values": [dict(vars(value)) for value in self.values], "more": self.more}


def release_differences(changes: Iterable[Change]) -> ReleaseDifferences:
    """What changes in releases that there were before. A release that comes or goes is told by its chart and version
    alone: all of its values are new, or gone."""
    values = [value for change in changes for value in _of(change)]
    return ReleaseDifferences(tuple(values[:VALUES_MAX]), max(0, len(values) - VALUES_MAX))


def _of(change: Change) -> Iterator[ValueDifference]:
    before, after = (_shown(release, change) for release in (change.before, change.after))
    for path in sorted({*before, *after}):
        if before.get(path) != after.get(path):
            yield ValueDifference(change.release.key, path, before.get(path), after.get(path))


def _shown(release: Release | None, change: Change) -> dict[str, str]:
    if release is None:
        return {}
    chart = {"chart": release.chart, "version": release.version}
    values = dict(_leaves("", release.values)) if change.before and change.after else {}
    return {**values, **{name: _text(text) for name, text in chart.items()}}


def _leaves(path: str, value: Any) -> Iterator[tuple[str, str]]:
    """The values below a path that hold no others."""
    if isinstance(value, Mapping) and value:
        for key, part in value.items():
            yield from _leaves(f"{path}.{key}" if path else str(key), part)
    elif isinstance(value, list | tuple) and value:
        for index, part in enumerate(value):
            yield from _leaves(f"{path}[{index}]", part)
    else:
        yield path, _text(value)


def _text(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= TEXT_CHARACTERS_MAX else f"{text[:TEXT_CHARACTERS_MAX]}…"
