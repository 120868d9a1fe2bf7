"""What a chart's declared interfaces give for one set of values: the topics that a running instance must open.

The entry's interfaces are templates (docs/reference/interfaces.md); `values` in them are the chart's values with a
set's values merged over. A `{name}` that is left in a topic stands for any text within one level.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import (
    COLLECTION,
    MQTT_TOPIC,
    MQTT_TOPIC_CHARACTERS_MAX,
    ROS_TOPIC,
    ROS_TOPIC_CHARACTERS_MAX,
    ROS_TYPE,
    VARIABLE,
)
from robotkube.foundation.documents.core.value_templates import Render, expand_for_each
from robotkube.registry.catalogue.core.interface_declarations import DURABILITIES, ENCODINGS, QOS_MAX, RELIABILITIES
from robotkube.registry.evidence.core.statements import Check

ROS, MQTT, DATABASE = "ros", "mqtt", "database"
IN, OUT = "in", "out"
RKF1, TEXT = "rkf1", "text"
TOPICS_MAX = 40
COLLECTION_CHARACTERS_MAX = 200
COMMON_TOPICS: Mapping[tuple[str, str], str] = {
    ("/rosout", OUT): "rcl_interfaces/msg/Log",
    ("/parameter_events", OUT): "rcl_interfaces/msg/ParameterEvent",
    ("/robotkube/gaps", IN): "std_msgs/msg/String",
    ("/robotkube/gaps", OUT): "std_msgs/msg/String",
}
"""(topic, direction) -> type: what every rclpy node opens, and where bridges report gaps to recorders; an entry
need not and cannot declare them."""

_PATTERN = re.compile(rf"\{{{VARIABLE.pattern}\}}", re.ASCII)
_NAMES = {
    ROS: (ROS_TOPIC, "a ROS topic such as /vehicles/vehicle_00/pose", ROS_TOPIC_CHARACTERS_MAX),
    MQTT: (MQTT_TOPIC, "an MQTT topic such as status/vehicle-00, without wildcards", MQTT_TOPIC_CHARACTERS_MAX),
    DATABASE: (COLLECTION, "the name of a collection such as samples", COLLECTION_CHARACTERS_MAX),
}


@dataclass(frozen=True)
class ExpectedTopic:
    """A topic (or collection) that one interface gives. `type`, `reliability` and `durability` belong to ROS; `qos`,
    `retain`, `encoding` and perhaps `type` (inside the batch) to MQTT. `causes` names the interface that shows
    something when this one gets something; `element` is the element of forEach, as JSON."""

    interface: str
    medium: str
    direction: str
    topic: str
    type: str = ""
    reliability: str = ""
    durability: str = ""
    qos: int = 0
    retain: bool = False
    encoding: str = ""
    causes: str = ""
    element: str = ""

    @property
    def title(self) -> str:
        """The topic as checks name it."""
        return f"{self.medium} {self.direction} {self.topic}"

    @property
    def example(self) -> str:
        """A topic that fits: the topic itself, or with a word in place of each pattern."""
        return _PATTERN.sub(lambda match: f"suite_{match[0][1:-1]}", self.topic)

    def matches(self, topic: str) -> bool:
        """Return whether `topic` is this one, or fits its pattern."""
        parts = [re.escape(part) for part in _PATTERN.split(self.topic)]
        return re.fullmatch("[^/#]+".join(parts), topic) is not None


def expected_topics(
    interfaces: Sequence[Mapping[str, Any]], values: Mapping[str, Any], render: Render
) -> tuple[ExpectedTopic, ...]:
    """The topics that the entry's interfaces (their form is checked: `interface_declarations`) give for the chart's
    merged values. DocumentError names every interface that gives none, or a wrong one."""
    expected: list[ExpectedTopic] = []
    problems: list[str] = []
    for interface in interfaces:
        try:
            expected += interface_topics(interface, values, render)
        except DocumentError as error:
            problems.append(f"interface {interface.get('name')}: {error}")
    titles = [topic.title for topic in expected]
    problems += [f"{title} stands twice; declare it once" for title in sorted(set(titles)) if titles.count(title) > 1]
    if len(expected) > TOPICS_MAX:
        problems.append(f"{len(expected)} topics are more than {TOPICS_MAX}; use smaller test values")
    if problems:
        raise DocumentError("spec.interfaces", problems)
    return tuple(expected)


def interface_topics(
    interface: Mapping[str, Any], values: Mapping[str, Any], render: Render
) -> Iterator[ExpectedTopic]:
    """The topics that one interface gives for the chart's merged values; DocumentError when one cannot be."""
    variables = interface.get("forEach") or {}
    for names in expand_for_each(variables, {"values": values}, render):
        element = json.dumps([names[variable] for variable in variables], sort_keys=True, default=str)
        rendered = {
            key: render(interface[key], names) for key in ("topic", "type", "qos", "encoding") if key in interface
        }
        problems: list[str] = []
        topic = ExpectedTopic(
            interface=str(interface["name"]),
            medium=str(interface["medium"]),
            direction=str(interface["direction"]),
            topic=_topic(rendered["topic"], str(interface["medium"]), problems),
            causes=str(interface.get("causes", "")),
            element=element if variables else "",
            **_details(rendered, str(interface["medium"]), problems),
        )
        if problems:
            raise DocumentError(f"topic {rendered['topic']!r:.80}", problems)
        yield topic


def ros_topic_names(interface: Mapping[str, Any], values: Mapping[str, Any], render: Render) -> list[str]:
    """The names of the ROS topics that one interface gives, whatever else of it is wrong, and however long they are;
    DocumentError when they cannot be rendered."""
    names = [
        render(interface["topic"], scope)
        for scope in expand_for_each(interface.get("forEach") or {}, {"values": values}, render)
    ]
    return [name for name in names if isinstance(name, str) and ROS_TOPIC.fullmatch(_PATTERN.sub("a", name))]


def _topic(topic: Any, medium: str, problems: list[str]) -> str:
    pattern, description, characters_max = _NAMES[medium]
    plain = _PATTERN.sub("a", topic) if isinstance(topic, str) else ""
    if not pattern.fullmatch(plain):
        problems.append(f"is not {description}")
    elif len(plain) > characters_max:
        problems.append(f"has {len(plain)} characters, and {medium} takes {characters_max}; give it a shorter name")
    return str(topic)


def _details(rendered: Mapping[str, Any], medium: str, problems: list[str]) -> dict[str, Any]:
    quality = rendered.get("qos") or {}
    details: dict[str, Any] = {}
    if "type" in rendered:
        details["type"] = str(rendered["type"])
        if not ROS_TYPE.fullmatch(details["type"]):
            problems.append(f"type {details['type']!r:.60} is not written like geometry_msgs/msg/PoseStamped")
    if medium == ROS:
        details["reliability"] = _one_of(quality.get("reliability"), RELIABILITIES, "qos.reliability", problems)
        details["durability"] = _one_of(quality.get("durability"), DURABILITIES, "qos.durability", problems)
    if medium == MQTT:
        details["qos"] = _one_of(quality.get("qos"), range(QOS_MAX + 1), "qos.qos", problems)
        details["retain"] = _one_of(quality.get("retain"), (False, True), "qos.retain", problems)
        details["encoding"] = _one_of(rendered.get("encoding", RKF1), ENCODINGS, "encoding", problems)
    return details


def _one_of(value: Any, allowed: Sequence[Any], key: str, problems: list[str]) -> Any:
    if any(value == word and type(value) is type(word) for word in allowed):
        return value
    problems.append(f"{key} is {value!r:.40} and must be one of {', '.join(str(word).lower() for word in allowed)}")
    return allowed[0]


def outputs_of(expected: Sequence[ExpectedTopic], given: ExpectedTopic) -> tuple[int, ...]:
    """Places of the outputs one of which must show something when `given` gets something: those of the interface that
    it causes, and of these the one of the same element when both run over the same elements."""
    places = [i for i, topic in enumerate(expected) if topic.direction == OUT and topic.interface == given.causes]
    same = [i for i in places if given.element and expected[i].element == given.element]
    return tuple(same or places)


def declaration_checks(
    interfaces: Sequence[Mapping[str, Any]], sets: Mapping[str, Sequence[ExpectedTopic]]
) -> list[Check]:
    """What can be judged before anything runs: every input states its output, and the sets give different topics."""
    return [*_cause_checks(interfaces), *_difference_checks(interfaces, sets)]


def _cause_checks(interfaces: Sequence[Mapping[str, Any]]) -> Iterator[Check]:
    outputs = [str(interface["name"]) for interface in interfaces if interface["direction"] == OUT]
    for interface in interfaces:
        if interface["direction"] != IN:
            continue
        name = f"interface {interface['name']} states its output"
        if interface.get("causes") in outputs:
            yield Check(name, True)
        elif interface.get("causes"):
            problem = f"causes is {interface['causes']!r}, which is no interface of direction out"
            yield Check(
                name, False, problem, f"name one of {', '.join(outputs) or 'the outputs, and declare one first'}"
            )
        elif outputs:
            fix = f"write causes: one of {', '.join(outputs)}: what must show something when this input gets something"
            yield Check(name, False, "it has no `causes`: nothing says which output its input leads to", fix)
        else:
            fix = "declare what the chart gives out (ROS, MQTT or documents in the database) and name it under causes"
            yield Check(name, False, "nothing shows that the input is used: the entry declares no output at all", fix)


def _difference_checks(
    interfaces: Sequence[Mapping[str, Any]], sets: Mapping[str, Sequence[ExpectedTopic]]
) -> Iterator[Check]:
    name = "the test sets give different topics"
    if not any("{" in str(interface["topic"]) or interface.get("forEach") for interface in interfaces):
        return
    seen: dict[frozenset[str], str] = {}
    for set_name, topics in sets.items():
        titles = frozenset(topic.title for topic in topics)
        if titles in seen:
            problem = f"{seen[titles]} and {set_name} both give {', '.join(sorted(titles)) or 'no topic at all'}"
            fix = "the topics are templates or patterns: give every set values that lead to other topics"
            yield Check(name, False, problem, fix)
            return
        seen[titles] = set_name
    yield Check(name, True)
