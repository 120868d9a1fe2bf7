"""Rules as values: one class per kind. `reading` reads them from documents, `json_schema` describes these."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from robotkube.robots.ros.core.topic_patterns import TopicPattern
from robotkube.robots.rules.core.events import NOTHING

PROXIMITY, GEOFENCE, THRESHOLD, RATE, ABSENCE = "proximity", "geofence", "threshold", "rate", "absence"
COMBINATION, CEL, PYTHON, ALWAYS = "combination", "cel", "python", "always"
KINDS = (PROXIMITY, GEOFENCE, THRESHOLD, RATE, ABSENCE, COMBINATION, CEL, PYTHON, ALWAYS)

AGENT, PAIR, GROUP = "agent", "pair", "group"
SCOPES = (AGENT, PAIR, GROUP)

ALL, ANY, SEQUENCE = "all", "any", "sequence"

STALE_SECONDS_DEFAULT = 1.0
EXPIRE_SECONDS_DEFAULT = 60.0
BUDGET_SECONDS_DEFAULT = 0.1
PLUGIN_BUFFER_SECONDS_DEFAULT = 10.0

Point = tuple[float, float]
Ring = tuple[Point, ...]
"""Corners; the last is joined to the first."""


class Level(NamedTuple):
    """Two bounds of a number: an event starts beyond one and stops beyond the other. `above`: beyond is greater."""

    above: bool
    start: float
    stop: float


class Proximity(NamedTuple):
    """Two agents nearer than `start_distance_m`; it ends when they are farther than `stop_distance_m`.

    `position` is the path of x, y and z. Positions whose stamps differ by more than `stale_seconds` are not compared.
    """

    topic: TopicPattern
    start_distance_m: float
    stop_distance_m: float
    stale_seconds: float = STALE_SECONDS_DEFAULT
    position: str = "pose.position"


class Geofence(NamedTuple):
    """An agent within an area (or outside it): polygons, each an outer ring and holes. Who has gone in counts as in up
    to `margin` outside, and the other way round; in the unit of the coordinates."""

    topic: TopicPattern
    polygons: tuple[tuple[Ring, ...], ...]
    inside: bool = True
    margin: float = 0.0
    x: str = "pose.position.x"
    y: str = "pose.position.y"


class Threshold(NamedTuple):
    """A number in a message beyond a bound."""

    topic: TopicPattern
    field: str
    level: Level


class Rate(NamedTuple):
    """Messages per second, counted over the last `window_seconds`, beyond a bound."""

    topic: TopicPattern
    level: Level
    window_seconds: float


class Absence(NamedTuple):
    """No message for `seconds`."""

    topic: TopicPattern
    seconds: float


class Part(NamedTuple):
    """A rule in a combination; `negated`: it must not hold."""

    rule: str
    negated: bool = False


class Combination(NamedTuple):
    """Other rules together: all of them hold, any of them, or their starts come one after the other within a time."""

    mode: str
    parts: tuple[Part, ...]
    within_seconds: float = 0.0


class Cel(NamedTuple):
    """An expression over `fields` (name -> path in the message); `until`: what has to hold for the end."""

    topic: TopicPattern
    fields: Mapping[str, str]
    expression: str
    until: str = ""
    stale_seconds: float = STALE_SECONDS_DEFAULT
    budget_seconds: float = BUDGET_SECONDS_DEFAULT


class Python(NamedTuple):
    """A rule of an installed package, by its name in the entry point group `robotkube.rules`."""

    plugin: str
    topics: tuple[TopicPattern, ...]
    settings: Mapping[str, Any] = NOTHING
    budget_seconds: float = BUDGET_SECONDS_DEFAULT
    buffer_seconds: float = PLUGIN_BUFFER_SECONDS_DEFAULT


class Always(NamedTuple):
    """A rule that holds from the first moment on."""


ConditionSettings = Proximity | Geofence | Threshold | Rate | Absence | Combination | Cel | Python | Always


class Timing(NamedTuple):
    """The times that make an event of what holds, in seconds of the messages' own time; 0 asks for nothing.

    `sustained`: it has to hold for so long; `minimum_interval`: least time between two starts; `cooldown`: from a stop
    to the next start; `every`: an agent's messages are evaluated once in so long; `expire`: agents that send
    nothing for so long have no event any more.
    """

    sustained: float = 0.0
    minimum_interval: float = 0.0
    cooldown: float = 0.0
    every: float = 0.0
    expire: float = EXPIRE_SECONDS_DEFAULT


class Rule(NamedTuple):
    """One rule. `agents`: the only ones it evaluates, all when empty. A `silent` rule gives no events of its own; it is
    there for combinations. Of scope `group` it has one event, while it holds for at least `at_least` members."""

    name: str
    condition: ConditionSettings
    scope: str = AGENT
    agents: tuple[str, ...] = ()
    at_least: int = 1
    timing: Timing = Timing()
    silent: bool = False

    @property
    def kind(self) -> str:
        """The kind in the document's word."""
        return type(self.condition).__name__.lower()

    @property
    def topics(self) -> tuple[TopicPattern, ...]:
        """The topics it reads."""
        if isinstance(self.condition, Python):
            return self.condition.topics
        topic = getattr(self.condition, "topic", None)
        return () if topic is None else (topic,)


def paths(rule: Rule) -> tuple[str, ...]:
    """The fields that a rule reads in messages of its topic."""
    condition = rule.condition
    match condition:
        case Proximity():
            return tuple(f"{condition.position}.{axis}" for axis in "xyz")
        case Geofence():
            return (condition.x, condition.y)
        case Threshold():
            return (condition.field,)
        case Cel():
            return tuple(condition.fields.values())
    return ()
