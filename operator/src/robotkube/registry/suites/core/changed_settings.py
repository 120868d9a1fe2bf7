"""Changed settings of a chart under test: values that differ from the first set's, and whether pod template and ROS
graph follow what they change, as the entry's `settings` says."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

from robotkube.errors import InputError
from robotkube.registry.catalogue.core.chart_versions import RESTART, WATCHED
from robotkube.registry.catalogue.core.expected_topics import IN, ROS, ExpectedTopic
from robotkube.registry.evidence.core.statements import NOT_SHOWN
from robotkube.registry.suites.core.pod_security import mapping
from robotkube.robots.ros.core.graph import Endpoint

PLACED_BY = "placement"  # where it runs is no setting: another place is another pod
NO_SETTINGS = frozenset({PLACED_BY, "global", "robotkube-app", "resources", "terminationGracePeriodSeconds"})
"""Values of the library chart, which no process reads."""
PATHS_SHOWN_MAX = 20
VARIATIONS_MAX = 4
KINDS_OF_PODS = frozenset({"Deployment"})

Object = Mapping[str, Any]
Topics = Sequence[ExpectedTopic]
TopicsOf = Callable[[Mapping[str, Any]], Topics]
"""The topics that the ROS graph shows with these values; InputError when the values cannot be."""


def declared(entry: Mapping[str, Any]) -> str:
    """The entry's `spec.settings`; empty when it says nothing."""
    return str(mapping(entry.get("spec")).get("settings") or "")


def variations(
    first: Mapping[str, Any], others: Sequence[Mapping[str, Any]]
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The first set's values with one value of another set in its place, and that value's path; at most
    VARIATIONS_MAX."""
    settings = [{key: value for key, value in other.items() if key != PLACED_BY} for other in others]
    return islice((one for other in settings for one in _replaced(first, other, "values")), VARIATIONS_MAX)


def _replaced(first: Mapping[str, Any], other: Mapping[str, Any], path: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for key, value in other.items():
        own = first.get(key)
        if isinstance(own, Mapping) and isinstance(value, Mapping):
            for inner, changed in _replaced(own, value, f"{path}.{key}"):
                yield inner, {**first, key: changed}
        elif own != value:
            yield f"{path}.{key}", {**first, key: value}


def account(
    first: Mapping[str, Any], to: Mapping[str, Any], every: Sequence[Mapping[str, Any]], topics: TopicsOf
) -> str:
    """The paths of values whose change from `first` to `to` the ROS graph shows by itself, and of the others that a
    process may read, of all those in `every`."""
    before = topics(first)
    changes = _replaced(first, {key: value for key, value in to.items() if key != PLACED_BY}, "values")
    shown = [path for path, values in changes if _shows(values, before, topics)]
    known = dict.fromkeys(path for values in every for path in _paths(_settings(values), "values"))
    others = [path for path in known if not any(f"{path}.".startswith(f"{one}.") for one in shown)]
    parts = [f"shown to be at work: {_listed(shown)}"] if shown else []
    return "; ".join([*parts, f"{NOT_SHOWN} {_listed(others)}"] if others else parts)


def _shows(values: Mapping[str, Any], before: Topics, topics: TopicsOf) -> bool:
    try:
        return differ(before, topics(values))
    except InputError:  # it goes with another one only
        return False


def _settings(values: Mapping[str, Any]) -> Mapping[str, Any]:
    return {key: value for key, value in values.items() if key not in NO_SETTINGS}


def _paths(values: Mapping[str, Any], path: str) -> Iterator[str]:
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _paths(value, f"{path}.{key}")
        else:
            yield f"{path}.{key}"


def _listed(paths: Sequence[str]) -> str:
    more = len(paths) - PATHS_SHOWN_MAX
    return ", ".join([*paths[:PATHS_SHOWN_MAX], *([f"and {more} more"] if more > 0 else [])])


def identity(item: Object) -> tuple[str, str]:
    """An object's kind and name."""
    return str(item.get("kind")), str(mapping(item.get("metadata")).get("name"))


def moves_pod(before: Sequence[Object], after: Sequence[Object]) -> bool | None:
    """Return whether the pod is another one with the objects `after`; None when they are the same as those before."""
    if list(before) == list(after):
        return None
    return _templates(before) != _templates(after)


def _templates(objects: Sequence[Object]) -> list[Any]:
    return [mapping(item.get("spec")).get("template") for item in objects if item.get("kind") in KINDS_OF_PODS]


def disagreements(settings: str, moved: Mapping[str, bool]) -> list[str]:
    """What the entry's `settings` says and the chart does not do. `moved`: path of a changed value -> whether it gives
    another pod template."""
    stays = [path for path, moves in moved.items() if not moves]
    if settings == RESTART and stays:
        return [f"{', '.join(stays)}: a change leaves the pod template as it is, so the old process goes on with it"]
    if settings == WATCHED and moved and not stays:
        return [f"{', '.join(moved)}: a change is a new pod template, so nothing is watched"]
    return []


def visible(topics: Topics) -> Topics:
    """The topics that the ROS graph shows although nothing is sent: an output whose name is a pattern is opened when
    there is something to publish."""
    return [t for t in topics if t.medium == ROS and (t.direction == IN or t.topic == t.example)]


def differ(before: Topics, after: Topics) -> bool:
    """Return whether other topics are open with the changed values."""
    return {topic.title for topic in before} != {topic.title for topic in after}


def unseen(before: Topics, after: Topics, endpoints: Sequence[Endpoint]) -> list[str]:
    """What the ROS graph does not show of changed values: topics that are not open, and those of before that still
    are."""
    missing = [t.title for t in after if not any(_is_end(t, end) for end in endpoints)]
    left = [
        t.title
        for t in before
        if any(_is_end(t, end) and not any(_is_end(new, end) for new in after) for end in endpoints)
    ]
    problems = [f"not open: {', '.join(missing)}"] if missing else []
    return problems + ([f"still open, as with the settings before: {', '.join(left)}"] if left else [])


def _is_end(topic: ExpectedTopic, end: Endpoint) -> bool:
    return topic.direction == end.direction and topic.matches(end.topic)
