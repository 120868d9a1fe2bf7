"""The settings of a bridge, which say what it carries, and the difference between two of them.

`out` topics go from the node's ROS network to MQTT, `in` topics the other way. A topic's MQTT name is `mqtt` + its ROS
name, its payload batches of messages. `{agent}` in a name stands for any agent: under `out` topics are discovered in
the ROS network while the bridge runs, under `in` all of them are subscribed to at the broker; a bridge's own agent is
never brought in that way, and what it brings in never goes out. A channel is a kind of traffic, CHANNELS in the order
in which they may send: each has an MQTT connection and a queue of its own. The two topics of the task gateway
(GATEWAY_TOPICS) are other: the agent's name follows theirs on MQTT, and the payload is the text of the
std_msgs/msg/String, so that whoever speaks MQTT alone can use them, too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import MQTT_TOPIC, NAME, ROS_TOPIC_PATTERN, ROS_TYPE, TRACE
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import join
from robotkube.robots.mqtt.core.message_properties import MQTT_PREFIX
from robotkube.robots.ros.core.topic_patterns import AGENT, TopicPattern, length_problem

SAFETY = "safety"
TELEMETRY = "telemetry"
BULK = "bulk"
CHANNELS = (SAFETY, TELEMETRY, BULK)
"""Kinds of traffic, the most urgent first."""
DEADLINE_SECONDS_MIN, DEADLINE_SECONDS_MAX = 0.05, 10.0
BATCHES = "frames"  # the value in settings, older than the word
MQTT_CLIENT = "mqtt_client"
DEPTH_DEFAULT = 1000
DEPTH_MAX = 100_000
TOPICS_MAX = 500
GATEWAY_TOPICS = {"/robotkube/tasks": "out", "/robotkube/task_status": "in"}
GATEWAY_TYPE = "std_msgs/msg/String"

_OPTIONAL = (
    "channel", "reliability", "durability", "depth", "format", "inject_timestamp", "mqtt_topic", "deadline_seconds",
)  # fmt: skip
_FORMAT = re.compile(f"{BATCHES}|{MQTT_CLIENT}")
_CHANNEL = re.compile("|".join(CHANNELS))
_RELIABILITY = re.compile("reliable|best_effort")
_DURABILITY = re.compile("volatile|transient_local")


@lru_cache(maxsize=2 * TOPICS_MAX)
def _pattern(text: str) -> TopicPattern:
    return TopicPattern(text)


@dataclass(frozen=True)
class BridgedTopic:
    """One topic with its type and QoS profile on the ROS side, or one per agent when `name` holds `{agent}`.

    `gateway_agent` is the agent's name for a topic of the task gateway, empty for all others; `mqtt_topic` another MQTT
    name than `mqtt` + the ROS name; `inject_timestamp` is of the format mqtt_client. What waited longer than
    `deadline_seconds` for the broker is not sent any more; 0: there is no deadline."""

    name: str
    type: str
    channel: str = TELEMETRY
    reliability: str = "reliable"
    durability: str = "volatile"
    depth: int = DEPTH_DEFAULT
    format: str = BATCHES
    inject_timestamp: bool = False
    mqtt_topic: str = ""
    deadline_seconds: float = 0.0
    gateway_agent: str = ""

    @property
    def mqtt(self) -> str:
        """The topic's MQTT name."""
        if self.gateway_agent:
            return f"{self.name[1:]}/{self.gateway_agent}"
        return self.mqtt_topic or MQTT_PREFIX + self.name

    @property
    def filter(self) -> str:
        """The MQTT filter to subscribe to: the level that names the agent is any."""
        return "/".join("+" if AGENT in level else level for level in self.mqtt.split("/"))

    @property
    def general(self) -> bool:
        """Return whether it stands for one topic per agent."""
        return AGENT in self.name

    @property
    def retained(self) -> bool:
        """Return whether the broker keeps its last batch for late subscribers."""
        return self.durability == "transient_local"

    def agent(self, name: str) -> str | None:
        """The agent whose ROS topic this is, if it is one of these."""
        return _pattern(self.name).agent(name)

    def named(self, name: str) -> BridgedTopic:
        """The one topic of that ROS name."""
        return replace(self, name=name)


@dataclass(frozen=True)
class BridgeSettings:
    """The settings of a bridge, its `config.yaml`; topics by name. `trace` goes with every message; `publish_types`:
    definitions of the types are retained at the broker; `publish_gaps`: what is missing in what comes in is published
    on GAPS_TOPIC."""

    agent: str
    outgoing: Mapping[str, BridgedTopic]
    incoming: Mapping[str, BridgedTopic]
    trace: str = ""
    publish_types: bool = False
    publish_gaps: bool = False

    @property
    def channels(self) -> frozenset[str]:
        """Connections that are needed; telemetry always, as a sign of life."""
        topics = [*self.outgoing.values(), *self.incoming.values()]
        return frozenset([TELEMETRY, *(topic.channel for topic in topics)])


def read_bridge_settings(document: Mapping[str, Any], where: str) -> BridgeSettings:
    """The settings; DocumentError names `where` and every problem."""
    reader = Reader(where)
    values = reader.mapping(document, "", ["agent"], ["out", "in", "trace", "publish_types", "publish_gaps"])
    agent = reader.text(values.get("agent"), "agent", NAME)
    settings = BridgeSettings(
        agent=agent,
        outgoing=_topics(reader, values.get("out"), "out", agent),
        incoming=_topics(reader, values.get("in"), "in", agent),
        trace=reader.word(values.get("trace") or None, "trace", TRACE, ""),
        publish_types=_switch(reader, values, "", "publish_types"),
        publish_gaps=_switch(reader, values, "", "publish_gaps"),
    )
    for name in sorted(set(settings.outgoing) & set(settings.incoming)):
        if not settings.incoming[name].general:
            reader.problems.append(f"in: {name} stands under out as well and would go round in circles; keep one")
    reader.finish()
    return settings


def _switch(reader: Reader, values: Mapping[str, Any], path: str, key: str) -> bool:
    value = values.get(key, False)
    if not isinstance(value, bool):
        reader.problems.append(f"{join(path, key)}: {value!r} must be true or false")
    return value is True


def _topics(reader: Reader, value: Any, path: str, agent: str) -> dict[str, BridgedTopic]:
    items = reader.sequence(value, path)
    if len(items) > TOPICS_MAX:
        reader.problems.append(f"{path}: {len(items)} topics are more than {TOPICS_MAX}; split the bridge")
    topics: dict[str, BridgedTopic] = {}
    names: dict[str, str] = {}
    for index, item in enumerate(items[:TOPICS_MAX]):
        topic = _topic(reader, item, f"{path}[{index}]")
        if topic.name in GATEWAY_TOPICS:
            topic = _gateway_topic(reader, topic, path, index, agent)
        if topic.name in topics:
            reader.problems.append(f"{path}[{index}].name: {topic.name} stands twice; keep one")
        elif names.setdefault(topic.mqtt, topic.name) != topic.name:
            reader.problems.append(
                f"{path}[{index}]: {topic.name} and {names[topic.mqtt]} are both {topic.mqtt} at the broker; keep one"
            )
        topics[topic.name] = topic
    return topics


def _gateway_topic(reader: Reader, topic: BridgedTopic, path: str, index: int, agent: str) -> BridgedTopic:
    """A topic of the task gateway: its direction, type and durability are given."""
    where = f"{path}[{index}]"
    if GATEWAY_TOPICS[topic.name] != path:
        reader.problems.append(f"{where}: {topic.name} goes only {GATEWAY_TOPICS[topic.name]}; move it there")
    reader.equal(topic.type, f"{where}.type", GATEWAY_TYPE)
    reader.equal(topic.durability, f"{where}.durability", "volatile")  # kept messages would be requests once more
    return replace(topic, gateway_agent=agent)


def _topic(reader: Reader, item: Any, path: str) -> BridgedTopic:
    values = reader.mapping(item, path, ["name", "type"], _OPTIONAL)
    depth = values.get("depth", DEPTH_DEFAULT)
    if not isinstance(depth, int) or isinstance(depth, bool) or not 1 <= depth <= DEPTH_MAX:
        reader.problems.append(f"{join(path, 'depth')}: {depth!r} must be a number of messages from 1 to {DEPTH_MAX}")
    topic = BridgedTopic(
        name=reader.text(values.get("name"), join(path, "name"), ROS_TOPIC_PATTERN),
        type=reader.text(values.get("type"), join(path, "type"), ROS_TYPE),
        channel=reader.word(values.get("channel"), join(path, "channel"), _CHANNEL, TELEMETRY),
        reliability=reader.word(values.get("reliability"), join(path, "reliability"), _RELIABILITY, "reliable"),
        durability=reader.word(values.get("durability"), join(path, "durability"), _DURABILITY, "volatile"),
        depth=depth if isinstance(depth, int) else DEPTH_DEFAULT,
        format=reader.word(values.get("format"), join(path, "format"), _FORMAT, BATCHES),
        inject_timestamp=_switch(reader, values, path, "inject_timestamp"),
        mqtt_topic=reader.word(values.get("mqtt_topic"), join(path, "mqtt_topic"), MQTT_TOPIC, ""),
        deadline_seconds=_deadline(reader, values.get("deadline_seconds"), path),
    )
    reader.problems += [f"{path}.{problem}" for problem in _contradictions(topic, values)]
    return topic


def _deadline(reader: Reader, value: Any, path: str) -> float:
    if value is None:
        return 0.0
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not DEADLINE_SECONDS_MIN <= value <= DEADLINE_SECONDS_MAX:
        bounds = f"from {DEADLINE_SECONDS_MIN} to {DEADLINE_SECONDS_MAX:g}"
        reader.problems.append(f"{join(path, 'deadline_seconds')}: {value!r} must be a number of seconds {bounds}")
        return 0.0
    return float(value)


def _contradictions(topic: BridgedTopic, values: Mapping[str, Any]) -> list[str]:
    problems = []
    if topic.name.count(AGENT) > 1:
        problems.append(f"name: {topic.name} holds {AGENT} more than once; name it once")
    if problem := length_problem(topic.name):
        problems.append(f"name: {topic.name:.60}... {problem}")
    if topic.general and topic.mqtt_topic:
        problems.append(f"mqtt_topic: goes with one topic only; name the agent in {topic.name}, or leave it out")
    for key in ("inject_timestamp", "mqtt_topic"):
        if values.get(key) and topic.format != MQTT_CLIENT:
            problems.append(f"{key}: is only of format {MQTT_CLIENT}; set that, or leave it out")
    return problems


@dataclass(frozen=True)
class Difference:
    """Names of topics to close and topics to open, in that order; a topic that changed is in both."""

    closed: tuple[str, ...]
    opened: tuple[BridgedTopic, ...]


def difference(old: Mapping[str, BridgedTopic], new: Mapping[str, BridgedTopic]) -> Difference:
    """The difference that turns `old` into `new`; topics that stay the same are not touched."""
    return Difference(
        closed=tuple(name for name, topic in old.items() if new.get(name) != topic),
        opened=tuple(topic for name, topic in new.items() if old.get(name) != topic),
    )


def check_agent(old: BridgeSettings | None, new: BridgeSettings, where: str) -> None:
    """Check that the agent is the same: the broker's sessions are bound to its name. DocumentError when it is not."""
    if old is not None and old.agent != new.agent:
        raise DocumentError(where, [f"agent: cannot change from {old.agent} to {new.agent}; make a new release"])
