"""What a bridge carries: its settings, and the difference between two of them.

`out` topics go from the node's ROS network to MQTT, `in` topics the other way. A topic's MQTT name is `mqtt` + its ROS
name, its payload frames of messages. Channels are MQTT connections of their own, so that large messages do not hold up
small ones. The two topics of the task door (DOOR_TOPICS) are other: the agent's name follows theirs on MQTT, and the
payload is the text of the std_msgs/msg/String, so that whoever speaks MQTT alone can use them, too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from robotkube.domain.documents import Reader
from robotkube.domain.errors import DocumentError
from robotkube.domain.texts import join

TELEMETRY, BULK = "telemetry", "bulk"
CHANNELS = (TELEMETRY, BULK)
DEPTH_DEFAULT, DEPTH_MAX = 1000, 100_000
TOPICS_MAX = 500
MQTT_PREFIX = "mqtt"
DOOR_TOPICS = {"/robotkube/tasks": "out", "/robotkube/task_status": "in"}
DOOR_TYPE = "std_msgs/msg/String"

_AGENT = re.compile(r"[a-z0-9]([-a-z0-9]*[a-z0-9])?")
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
_CHANNEL = re.compile("|".join(CHANNELS))
_RELIABILITY = re.compile("reliable|best_effort")
_DURABILITY = re.compile("volatile|transient_local")


@dataclass(frozen=True)
class BridgedTopic:
    """One topic with its type and quality of service on the ROS side; `door` is the agent's name for a topic of the
    task door, empty for all others."""

    name: str
    type: str
    channel: str = TELEMETRY
    reliability: str = "reliable"
    durability: str = "volatile"
    depth: int = DEPTH_DEFAULT
    door: str = ""

    @property
    def mqtt(self) -> str:
        """The topic's MQTT name."""
        return f"{self.name[1:]}/{self.door}" if self.door else MQTT_PREFIX + self.name

    @property
    def retained(self) -> bool:
        """Whether the broker keeps its last frame for late subscribers."""
        return self.durability == "transient_local"


@dataclass(frozen=True)
class BridgeSettings:
    """`config.yaml` of a bridge; topics by name."""

    agent: str
    outgoing: Mapping[str, BridgedTopic]
    incoming: Mapping[str, BridgedTopic]

    @property
    def channels(self) -> frozenset[str]:
        """Connections that are needed; telemetry always, as a sign of life."""
        topics = [*self.outgoing.values(), *self.incoming.values()]
        return frozenset([TELEMETRY, *(topic.channel for topic in topics)])


def read_bridge_settings(document: Mapping[str, Any], where: str) -> BridgeSettings:
    """The settings; DocumentError names `where` and every problem."""
    reader = Reader(where)
    values = reader.mapping(document, "", ["agent"], ["out", "in"])
    agent = reader.text(values.get("agent"), "agent", _AGENT)
    settings = BridgeSettings(
        agent=agent,
        outgoing=_topics(reader, values.get("out"), "out", agent),
        incoming=_topics(reader, values.get("in"), "in", agent),
    )
    for name in sorted(set(settings.outgoing) & set(settings.incoming)):
        reader.problems.append(f"in: {name} stands under out as well and would go round in circles; keep one")
    reader.finish()
    return settings


def _topics(reader: Reader, value: Any, path: str, agent: str) -> dict[str, BridgedTopic]:
    items = reader.sequence(value, path)
    if len(items) > TOPICS_MAX:
        reader.problems.append(f"{path}: {len(items)} topics are more than {TOPICS_MAX}; split the bridge")
    topics: dict[str, BridgedTopic] = {}
    for index, item in enumerate(items[:TOPICS_MAX]):
        topic = _topic(reader, item, f"{path}[{index}]")
        if topic.name in DOOR_TOPICS:
            topic = _door(reader, topic, path, index, agent)
        if topic.name in topics:
            reader.problems.append(f"{path}[{index}].name: {topic.name} stands twice; keep one")
        topics[topic.name] = topic
    return topics


def _door(reader: Reader, topic: BridgedTopic, path: str, index: int, agent: str) -> BridgedTopic:
    """A topic of the task door: its direction, type and durability are given."""
    where = f"{path}[{index}]"
    if DOOR_TOPICS[topic.name] != path:
        reader.problems.append(f"{where}: {topic.name} goes only {DOOR_TOPICS[topic.name]}; move it there")
    reader.equal(topic.type, f"{where}.type", DOOR_TYPE)
    reader.equal(topic.durability, f"{where}.durability", "volatile")  # kept messages would be asked again
    return replace(topic, door=agent)


def _topic(reader: Reader, item: Any, path: str) -> BridgedTopic:
    values = reader.mapping(item, path, ["name", "type"], ["channel", "reliability", "durability", "depth"])
    depth = values.get("depth", DEPTH_DEFAULT)
    if not isinstance(depth, int) or isinstance(depth, bool) or not 1 <= depth <= DEPTH_MAX:
        reader.problems.append(f"{join(path, 'depth')}: {depth!r} must be a number of messages from 1 to {DEPTH_MAX}")
    return BridgedTopic(
        name=reader.text(values.get("name"), join(path, "name"), _TOPIC),
        type=reader.text(values.get("type"), join(path, "type"), _TYPE),
        channel=reader.word(values.get("channel"), join(path, "channel"), _CHANNEL, TELEMETRY),
        reliability=reader.word(values.get("reliability"), join(path, "reliability"), _RELIABILITY, "reliable"),
        durability=reader.word(values.get("durability"), join(path, "durability"), _DURABILITY, "volatile"),
        depth=depth if isinstance(depth, int) else DEPTH_DEFAULT,
    )


@dataclass(frozen=True)
class Difference:
    """Names of topics to close and topics to open, in that order; a topic that changed is in both."""

    closed: tuple[str, ...]
    opened: tuple[BridgedTopic, ...]


def difference(old: Mapping[str, BridgedTopic], new: Mapping[str, BridgedTopic]) -> Difference:
    """What turns `old` into `new`; topics that stay the same are not touched."""
    return Difference(
        closed=tuple(name for name, topic in old.items() if new.get(name) != topic),
        opened=tuple(topic for name, topic in new.items() if old.get(name) != topic),
    )


def check_agent(old: BridgeSettings | None, new: BridgeSettings, where: str) -> None:
    """DocumentError when the agent changed: the broker's sessions are bound to its name."""
    if old is not None and old.agent != new.agent:
        raise DocumentError(where, [f"agent: cannot change from {old.agent} to {new.agent}; make a new release"])
