"""The expected events of a bag, and the score of the events that rules gave for it.

Times are seconds from the begin of the bags, or (text) times such as 2026-11-22T10:00:00.5Z.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from robotkube.foundation.documents.core.reader import MappingReader, Reader
from robotkube.robots.rules.core import START, Edge

EVENTS_MAX = 10_000
TOLERANCE_SECONDS_DEFAULT = 1.0
SECONDS_MAX = 1e6
NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class Event:
    """An event as a whole; `stop` is None while it lasts or (expected) when it does not matter. ns."""

    rule: str
    agents: tuple[str, ...]
    start: int
    stop: int | None = None


@dataclass(frozen=True)
class Expectations:
    """The expected events, and the least precision and recall and the greatest error of a start or stop that pass.

    `tolerance_seconds`: starts that are farther apart are different events."""

    events: tuple[Event, ...]
    tolerance_seconds: float = TOLERANCE_SECONDS_DEFAULT
    precision: float = 1.0
    recall: float = 1.0
    timing_seconds: float = TOLERANCE_SECONDS_DEFAULT


@dataclass(frozen=True)
class Score:
    """The result of a comparison. `precision`: share of the actual events that were expected; `recall`: share of the
    expected events that occurred; `timing_seconds`: greatest error of a start or stop, `timing_mean_seconds` the mean
    of all."""

    matched: int
    precision: float
    recall: float
    timing_seconds: float
    timing_mean_seconds: float
    missing: tuple[Event, ...]
    unexpected: tuple[Event, ...]
    failures: tuple[str, ...]


def events(edges: Sequence[Edge]) -> list[Event]:
    """Edges as events, in the order of their starts."""
    stops = {edge.id: edge.stamp for edge in edges if edge.edge != START}
    starts = [edge for edge in edges if edge.edge == START]
    return [Event(edge.rule, edge.agents, edge.stamp, stops.get(edge.id)) for edge in starts]


def read_expectations(document: Mapping[str, Any], where: str, begin: int) -> Expectations:
    """Read the document; `begin`: of the bags, ns. DocumentError names every problem."""
    reader = Reader(where)
    root = reader.keys_of(document)
    tolerance = root.number("tolerance_seconds", 0, SECONDS_MAX, TOLERANCE_SECONDS_DEFAULT)
    expectations = Expectations(
        events=tuple(_event(item, begin) for item in root.mappings("events", EVENTS_MAX, required=False)),
        tolerance_seconds=tolerance,
        precision=root.number("precision", 0, 1, 1.0),
        recall=root.number("recall", 0, 1, 1.0),
        timing_seconds=root.number("timing_seconds", 0, SECONDS_MAX, tolerance),
    )
    root.refuse_unknown_keys()
    reader.finish()
    return expectations


def _event(item: MappingReader, begin: int) -> Event:
    rule = item.text("rule")
    agents = item.texts("agents", 0)
    start = _moment(item, "start", begin)
    stop = _moment(item, "stop", begin) if item.has("stop") else None
    if stop is not None and stop < start:
        item.problem("stop", "must not be before start")
    item.refuse_unknown_keys()
    return Event(rule, tuple(sorted(agents)), start, stop)


def _moment(item: MappingReader, key: str, begin: int) -> int:
    value = item.value(key)
    if isinstance(value, (int, float)) and not isinstance(value, bool) and 0 <= value <= SECONDS_MAX:
        return begin + round(value * NANOSECONDS)
    if isinstance(value, str):
        try:
            moment = datetime.fromisoformat(value)
        except ValueError:
            moment = None
        if moment is not None and moment.tzinfo is not None:
            since = moment - datetime(1970, 1, 1, tzinfo=UTC)
            return (since.days * 86_400 + since.seconds) * NANOSECONDS + since.microseconds * 1000
    item.problem(key, "must be seconds from the begin of the bags, 0 or more, or a time such as 2026-11-22T10:00:00Z")
    return begin


def score(actual: Sequence[Event], expected: Expectations) -> Score:
    """Compare actual with expected events: the nearest starts of the same rule and agents belong together."""
    pairs = _pairs(actual, expected)
    errors = [abs(actual[f].start - expected.events[e].start) / NANOSECONDS for f, e in pairs]
    stops = [(actual[f].stop, expected.events[e].stop) for f, e in pairs]
    errors += [math.inf if a is None else abs(a - b) / NANOSECONDS for a, b in stops if b is not None]
    matched = len(pairs)
    paired_actual = {of_actual for of_actual, _ in pairs}
    paired_expected = {of_expected for _, of_expected in pairs}
    precision = matched / len(actual) if actual else 1.0
    recall = matched / len(expected.events) if expected.events else 1.0
    timing = max(errors, default=0.0)
    return Score(
        matched=matched,
        precision=precision,
        recall=recall,
        timing_seconds=timing,
        timing_mean_seconds=sum(errors) / len(errors) if errors else 0.0,
        missing=tuple(event for index, event in enumerate(expected.events) if index not in paired_expected),
        unexpected=tuple(event for index, event in enumerate(actual) if index not in paired_actual),
        failures=tuple(_failures(precision, recall, timing, expected)),
    )


def _pairs(actual: Sequence[Event], expected: Expectations) -> list[tuple[int, int]]:
    by_key: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    for index, event in enumerate(actual):
        by_key.setdefault((event.rule, tuple(sorted(event.agents))), []).append(index)
    tolerance = expected.tolerance_seconds * NANOSECONDS
    near = [
        (abs(actual[of_actual].start - event.start), of_actual, of_expected)
        for of_expected, event in enumerate(expected.events)
        for of_actual in by_key.get((event.rule, event.agents), ())
        if abs(actual[of_actual].start - event.start) <= tolerance
    ]
    pairs: list[tuple[int, int]] = []
    paired_actual: set[int] = set()
    paired_expected: set[int] = set()
    for _, of_actual, of_expected in sorted(near):
        if of_actual not in paired_actual and of_expected not in paired_expected:
            pairs.append((of_actual, of_expected))
            paired_actual.add(of_actual)
            paired_expected.add(of_expected)
    return pairs


def _failures(precision: float, recall: float, timing: float, expected: Expectations) -> list[str]:
    checks = (("precision", precision, expected.precision), ("recall", recall, expected.recall))
    failures = [f"{name} {value:.3f} is below {least:g}" for name, value, least in checks if value < least]
    if timing > expected.timing_seconds:
        failures.append(f"timing error {timing:.3f} s is above {expected.timing_seconds:g} s")
    return failures
