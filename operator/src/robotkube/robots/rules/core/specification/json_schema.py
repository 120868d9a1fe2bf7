"""The rules of a document as JSON Schema (draft 7), which editors and `helm` check before a detector reads them.

The reader refuses whatever the schema refuses. It alone finds bounds that cross, names that stand for nothing, fields
that a type has not, and areas that enclose nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.foundation.documents.core.patterns import EXPRESSION_NAME, NAME, ROS_TOPIC_PATTERN, anchored
from robotkube.robots.rules.core.specification import reading, specifications
from robotkube.robots.rules.core.specification.areas import COORDINATE_MAX

Schema = dict[str, Any]

TOPIC_PATTERN = anchored(ROS_TOPIC_PATTERN)
AGENT_PATTERN = anchored(NAME)
COMMON = ("name", "kind", "silent", "sustained_seconds", "minimum_interval_seconds", "cooldown_seconds")
SCOPED = ("scope", "agents", "at_least")
WATCHING = ("every_seconds", "expire_seconds")


def number(least: float, most: float, description: str, default: float | None = None) -> Schema:
    """The schema of a number within bounds."""
    schema: Schema = {"type": "number", "minimum": least, "maximum": most, "description": description}
    return schema if default is None else {**schema, "default": default}


def text(description: str, default: str | None = None, **more: Any) -> Schema:
    """The schema of a text that is not empty."""
    schema: Schema = {"type": "string", "minLength": 1, **more, "description": description}
    return schema if default is None else {**schema, "default": default}


def choice(words: Sequence[str], description: str, default: str | None = None) -> Schema:
    """The schema of one of some words."""
    schema: Schema = {"enum": list(words), "description": description}
    return schema if default is None else {**schema, "default": default}


_SECONDS = reading.SECONDS_MAX
_VALUE = reading.VALUE_MAX
_DISTANCE = (reading.DISTANCE_MIN, reading.DISTANCE_MAX)
_TOPIC = text("topic that is read; {agent} stands for any agent's ROS name", pattern=TOPIC_PATTERN)
_NAMES: Schema = {
    "type": "array",
    "minItems": 2,
    "maxItems": reading.PARTS_MAX,
    "items": {
        "oneOf": [
            text("name of a rule"),
            {
                "type": "object",
                "additionalProperties": False,
                "required": ["not"],
                "properties": {"not": text("name of a rule that must not hold")},
            },
        ]
    },
}
_RING: Schema = {
    "type": "array",
    "minItems": 3,
    "items": {
        "type": "array",
        "minItems": 2,
        "maxItems": 3,
        "items": {"type": "number", "minimum": -COORDINATE_MAX, "maximum": COORDINATE_MAX},
    },
}
_POLYGON: Schema = {"type": "array", "minItems": 1, "items": _RING}
_BUDGET = number(0.001, 10, "processor time of one evaluation; more suspends the rule", 0.1)

PROPERTIES: Mapping[str, Schema] = {
    "name": text("name, unique among the rules", maxLength=reading.RULE_NAME_LENGTH_MAX),
    "kind": choice(specifications.KINDS, "what is looked at"),
    "silent": {
        "type": "boolean",
        "default": False,
        "description": "it raises no events of its own and is there for combinations",
    },
    "sustained_seconds": number(0, _SECONDS, "it has to hold for so long before the event starts", 0),
    "minimum_interval_seconds": number(0, _SECONDS, "least time between two starts for the same agents", 0),
    "cooldown_seconds": number(0, _SECONDS, "least time from a stop to the next start for the same agents", 0),
    "every_seconds": number(0, _SECONDS, "an agent's messages are looked at once in so long; 0: each of them", 0),
    "expire_seconds": number(0.1, _SECONDS, "events of an agent that says nothing for so long end", 60),
    "scope": choice(specifications.SCOPES, "whose event it is: of each agent, of each two, or one of them all"),
    "agents": {
        "type": "array",
        "minItems": 1,
        "maxItems": reading.AGENTS_MAX,
        "items": {"type": "string", "pattern": AGENT_PATTERN},
        "description": "the only agents it looks at, and those of a group's event; without it all of them, of whom a "
        "group's event has those for whom it holds when it begins",
    },
    "at_least": {
        "type": "integer",
        "minimum": 1,
        "maximum": reading.AGENTS_MAX,
        "default": 1,
        "description": "of scope group: it must hold for so many agents (or pairs)",
    },
    "topic": _TOPIC,
    "start_distance_m": number(*_DISTANCE, "the event starts nearer than this, in metres"),
    "stop_distance_m": number(*_DISTANCE, "it stops farther than this, in metres; not less than the start"),
    "stale_seconds": number(0.001, 3600, "messages whose stamps differ by more are not compared", 1),
    "position": text("path of x, y and z in the message", "pose.position"),
    "area": {
        "type": "object",
        "additionalProperties": False,
        "required": ["type", "coordinates"],
        "description": "the area as in GeoJSON: lists of rings, the outer one first, then its holes",
        "properties": {
            "type": choice(("Polygon", "MultiPolygon"), "form"),
            "coordinates": {"type": "array", "description": "rings of [x, y]"},
        },
        "if": {"properties": {"type": {"const": "Polygon"}}},
        "then": {"properties": {"coordinates": _POLYGON}},
        "else": {"properties": {"coordinates": {"type": "array", "minItems": 1, "items": _POLYGON}}},
    },
    "when": choice(("inside", "outside"), "where the agent is while the event lasts", "inside"),
    "margin": number(0, reading.DISTANCE_MAX, "it stops only when the area's edge is farther than this", 0),
    "x": text("path of the first coordinate", "pose.position.x"),
    "y": text("path of the second coordinate", "pose.position.y"),
    "field": text("path of the number, such as data or pose.position.x"),
    "start_above": number(-_VALUE, _VALUE, "the event starts above this; needs stop_below"),
    "stop_below": number(-_VALUE, _VALUE, "it stops below this; not more than start_above"),
    "start_below": number(-_VALUE, _VALUE, "the event starts below this; needs stop_above"),
    "stop_above": number(-_VALUE, _VALUE, "it stops above this; not less than start_below"),
    "start_above_hz": number(0.001, reading.HZ_MAX, "too fast: the event starts above this; needs stop_below_hz"),
    "stop_below_hz": number(0.001, reading.HZ_MAX, "it stops below this; not more than start_above_hz"),
    "start_below_hz": number(0.001, reading.HZ_MAX, "too slow: the event starts below this; needs stop_above_hz"),
    "stop_above_hz": number(0.001, reading.HZ_MAX, "it stops above this; not less than start_below_hz"),
    "window_seconds": number(0.01, reading.RATE_WINDOW_MAX, "span over which messages are counted", 2),
    "seconds": number(0.01, _SECONDS, "no message for so long"),
    "all": {**_NAMES, "description": "rules that must all hold"},
    "any": {**_NAMES, "description": "rules of which one must hold"},
    "not": text("rule that must not hold"),
    "sequence": {
        **_NAMES,
        "items": text("name of a rule"),
        "description": "rules that start one after the other; it lasts as long as the last one",
    },
    "within_seconds": number(0.001, _SECONDS, "longest time from the first start to the last one"),
    "fields": {
        "type": "object",
        "minProperties": 1,
        "maxProperties": reading.FIELDS_MAX,
        "propertyNames": {"pattern": anchored(EXPRESSION_NAME), "not": {"enum": ["agent", "a", "b"]}},
        "additionalProperties": text("path of a field"),
        "description": "names in the expression, each with the path of a field",
    },
    "expression": text("CEL: true while the event lasts", maxLength=reading.EXPRESSION_LENGTH_MAX),
    "until": {
        "type": "string",
        "maxLength": reading.EXPRESSION_LENGTH_MAX,
        "default": "",
        "description": "CEL: true when the event ends; without it, when expression is false",
    },
    "budget_seconds": _BUDGET,
    "plugin": text("name in the entry point group robotkube.rules of an installed package"),
    "topics": {
        "type": "array",
        "minItems": 1,
        "maxItems": reading.PLUGIN_TOPICS_MAX,
        "uniqueItems": True,
        "items": _TOPIC,
        "description": "topics whose messages the rule gets",
    },
    "settings": {
        "type": "object",
        "additionalProperties": True,
        "description": "what the package's rule wants to know",
    },
    "buffer_seconds": number(0.01, 600, "how far back the rule can look", 10),
}


class Kind:
    """The keys of one kind. `choices`: groups of keys of which exactly one must be there."""

    def __init__(
        self,
        title: str,
        required: Sequence[str] = (),
        optional: Sequence[str] = (),
        choices: Sequence[Sequence[str]] = (),
        scopes: Sequence[str] = (),
        watching: bool = True,
    ) -> None:
        self.title = title
        self.required = tuple(required)
        self.choices = tuple(choices)
        self.scopes = tuple(scopes)
        of_choices = tuple(dict.fromkeys(key for keys in choices for key in keys))
        self.own = (*self.required, *of_choices, *optional)
        self.keys = (*COMMON, *(SCOPED if scopes else ()), *(WATCHING if watching else ()), *self.own)


_LEVEL = (("start_above", "stop_below"), ("start_below", "stop_above"))
_AGENT_GROUP = ("agent", "group")

KINDS: Mapping[str, Kind] = {
    "proximity": Kind(
        "Two agents are near each other.",
        ("topic", "start_distance_m", "stop_distance_m"),
        ("stale_seconds", "position"),
        scopes=("pair", "group"),
    ),
    "geofence": Kind(
        "An agent is inside an area, or outside it.", ("topic", "area"), ("when", "margin", "x", "y"), (), _AGENT_GROUP
    ),
    "threshold": Kind("A number in a message is beyond a bound.", ("topic", "field"), (), _LEVEL, _AGENT_GROUP),
    "rate": Kind(
        "Messages come too fast or too slowly.",
        ("topic",),
        ("window_seconds",),
        tuple((f"{start}_hz", f"{stop}_hz") for start, stop in _LEVEL),
        _AGENT_GROUP,
        watching=False,
    ),
    "absence": Kind(
        "No message comes. Agents that are listed are waited for from the start, others from their first message.",
        ("topic", "seconds"),
        (),
        (),
        _AGENT_GROUP,
        watching=False,
    ),
    "combination": Kind(
        "What other rules say together.",
        (),
        (),
        (("all",), ("any",), ("not",), ("sequence", "within_seconds")),
        ("agent", "pair", "group"),
        watching=False,
    ),
    "cel": Kind(
        "An expression over fields holds. Of scope pair: over a and b, each with the fields and agent.",
        ("topic", "fields", "expression"),
        ("until", "stale_seconds", "budget_seconds"),
        (),
        ("agent", "pair", "group"),
    ),
    "python": Kind(
        "What a rule of an installed package says.",
        ("plugin", "topics"),
        ("settings", "budget_seconds", "buffer_seconds"),
        (),
        ("agent", "pair", "group"),
    ),
    "always": Kind("Holds from the first moment on.", watching=False),
}
"""Kind -> its keys."""


def rules_schema() -> Schema:
    """The schema of the list of rules; it stands by itself."""
    return {
        "type": "array",
        "description": "Rules. An event lasts while its rule holds.",
        "maxItems": reading.RULES_MAX,
        "items": {
            "type": "object",
            "description": "One rule.",
            "additionalProperties": False,
            "required": ["name", "kind"],
            "properties": dict(PROPERTIES),
            "allOf": [_condition(name, kind) for name, kind in KINDS.items()],
        },
    }


def _condition(name: str, kind: Kind) -> Schema:
    """The keys that a rule of this kind must have and may not have."""
    then: Schema = {"propertyNames": {"enum": sorted(kind.keys)}}
    if kind.required:
        then["required"] = list(kind.required)
    if kind.choices:
        then["oneOf"] = [_one_of(keys, kind.choices) for keys in kind.choices]
    parts = []
    if kind.scopes:
        then["properties"] = {"scope": {"enum": list(kind.scopes)}}
        parts = [_group(name)]
    if name in ("proximity", "cel"):
        parts.append(_pair(name))
    if parts:
        then["allOf"] = parts
    return {"if": {"required": ["kind"], "properties": {"kind": {"const": name}}}, "then": then}


def _one_of(keys: Sequence[str], choices: Sequence[Sequence[str]]) -> Schema:
    others = [key for other in choices if other != keys for key in other]
    return {"required": list(keys), "not": {"anyOf": [{"required": [key]} for key in others]}}


def _group(kind: str) -> Schema:
    """The schema that `at_least` stands in scope group only, where a combination, which hears no agent itself, needs
    `agents`."""
    grouped: Schema = {"required": ["scope"], "properties": {"scope": {"const": "group"}}}
    needed: Schema = {"then": {"required": ["agents"]}} if kind == "combination" else {}
    return {"if": grouped, **needed, "else": {"not": {"required": ["at_least"]}}}


def _pair(kind: str) -> Schema:
    """The schema that scope pair, which is proximity's default, needs at least two agents, if any are named."""
    named: Schema = {"properties": {"agents": {"minItems": 2}}}
    scope: Schema = {"properties": {"scope": {"const": "pair"}}}
    if kind == "cel":
        return {"if": {**scope, "required": ["scope"]}, "then": {**named, "required": ["agents"]}}
    return {"if": scope, "then": named}
