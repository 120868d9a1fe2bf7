"""Settings of the event detector: the document `config.yaml` as values, or every problem in it with key and fix.

Topics, buffers and life cycle are read here, rules by `rules.core`, reactions by `reactions.core.settings`.
docs/reference/event-detector.md has every key.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robotkube.foundation.documents.core.patterns import ROS_TYPE, TASK
from robotkube.foundation.documents.core.reader import MappingReader, Reader
from robotkube.foundation.documents.core.yaml_codec import json_problems
from robotkube.robots.reactions.core.settings import (
    DeliveryReactionSettings,
    OperatorReactionSettings,
    ReactionSettings,
    RecordingReactionSettings,
    reaction_problems,
    read_reaction,
)
from robotkube.robots.ros.core.qos import DURABILITIES, LIVELINESSES, RELIABILITIES, TRANSIENT_LOCAL, RequestedQos
from robotkube.robots.ros.core.ring_buffers import (
    COUNT_DEFAULT,
    DUPLICATES_DROP,
    DUPLICATES_KEEP,
    JUMP_KEEP,
    JUMP_RESTART,
    BufferBounds,
)
from robotkube.robots.ros.core.topic_patterns import UNREADABLE_TOPIC, TopicPattern
from robotkube.robots.rules.core import RULES_MAX, Always, Rule, read_rules
from robotkube.robots.rules.core.specification.expressions import CheckExpressions
from robotkube.robots.rules.core.specification.topic_keys import read_topic_pattern

if TYPE_CHECKING:
    from robotkube.robots.ros.core.cdr_readers.readers import Layouts

TOPICS_MAX = 200
REACTIONS_MAX = 100
BUFFER_SECONDS_DEFAULT, BUFFER_SECONDS_MIN, BUFFER_SECONDS_MAX = 10.0, 0.01, 600.0
BUFFER_BYTES_DEFAULT, BUFFER_BYTES_MAX = 50_000_000, 1_000_000_000
PROCESS_BYTES_DEFAULT, PROCESS_BYTES_MIN, PROCESS_BYTES_MAX = 500_000_000, 1_000_000, 16_000_000_000
COUNT_MAX = 1_000_000
DEPTH_DEFAULT, DEPTH_MAX = 1000, 100_000
STALE_SECONDS_DEFAULT = 5.0
EXPIRE_SECONDS_DEFAULT = 600.0
SECONDS_MIN, SECONDS_MAX = 0.001, 86_400.0

ROS, MQTT = "ros", "mqtt"
SOURCES = (ROS, MQTT)
ACTIVE, BUFFERING, INACTIVE = "active", "buffering", "inactive"
STATES = (ACTIVE, BUFFERING, INACTIVE)
"""The states of a detector: all at work; subscribed and buffering only; subscribed to nothing."""

MISSING_TYPE_FIX = (
    "take another type, an image that has the package, or the topic from the broker (source: mqtt) when its sender "
    "publishes the type's definition"
)
TIME_JUMP = "time-jump"
"""The name of the built-in rule whose events are the jumps of a topic's time, and end at once."""


@dataclass(frozen=True)
class TopicSettings:
    """A subscription, or one per agent when `pattern` holds `{agent}`, and its buffer.

    A QoS policy that is None follows the publishers. Without a message for `stale_seconds` a topic
    counts as stale; one that a pattern found is forgotten after `expire_seconds`.
    """

    pattern: TopicPattern
    type: str
    source: str = ROS
    reliability: str | None = None
    durability: str | None = None
    depth: int = DEPTH_DEFAULT
    deadline_seconds: float | None = None
    liveliness: str | None = None
    liveliness_seconds: float | None = None
    stale_seconds: float = STALE_SECONDS_DEFAULT
    expire_seconds: float = EXPIRE_SECONDS_DEFAULT
    buffer_seconds: float = BUFFER_SECONDS_DEFAULT
    buffer_bytes: int = BUFFER_BYTES_DEFAULT
    buffer_count: int = COUNT_DEFAULT
    duplicates: str = DUPLICATES_DROP
    jump: str = JUMP_RESTART

    @property
    def latched(self) -> bool:
        """Return whether the settings make the topic latched: its last messages stay for later subscribers."""
        return self.durability == TRANSIENT_LOCAL

    @property
    def bounds(self) -> BufferBounds:
        """The buffer's bounds; a latched topic keeps as many messages as its depth says."""
        count = min(self.depth, self.buffer_count) if self.latched else self.buffer_count
        return BufferBounds(self.buffer_seconds, self.buffer_bytes, count)

    @property
    def requested_qos(self) -> RequestedQos:
        """The quality of service that the settings request."""
        return RequestedQos(
            self.reliability,
            self.durability,
            _nanoseconds(self.deadline_seconds),
            self.liveliness,
            _nanoseconds(self.liveliness_seconds),
        )


@dataclass(frozen=True)
class DetectorSettings:
    """The settings of a detector. `task`: key of the task that launched this detector, empty when none did. `bag`: path
    of a bag that fills the buffers at the start, empty for none."""

    name: str
    topics: tuple[TopicSettings, ...]
    rules: tuple[Rule, ...] = ()
    reactions: tuple[ReactionSettings, ...] = ()
    task: str = ""
    state: str = ACTIVE
    buffer_bytes: int = PROCESS_BYTES_DEFAULT
    bag: str = ""

    @property
    def agent(self) -> str:
        """The agent it belongs to: its namespace."""
        return self.name.partition("/")[0]

    @property
    def types(self) -> Mapping[str, str]:
        """Topic pattern -> message type."""
        return {topic.pattern.text: topic.type for topic in self.topics}

    @property
    def recordings(self) -> tuple[RecordingReactionSettings, ...]:
        """The recording reactions."""
        return tuple(reaction for reaction in self.reactions if isinstance(reaction, RecordingReactionSettings))

    @property
    def operators(self) -> tuple[OperatorReactionSettings, ...]:
        """The operator reactions."""
        return tuple(reaction for reaction in self.reactions if isinstance(reaction, OperatorReactionSettings))

    @property
    def deliveries(self) -> tuple[DeliveryReactionSettings, ...]:
        """The reactions that notify a receiver of an event: webhooks, MQTT messages, installed ones."""
        known = (RecordingReactionSettings, OperatorReactionSettings)
        return tuple(reaction for reaction in self.reactions if not isinstance(reaction, known))

    def is_always(self, rule: str) -> bool:
        """Return whether the rule of this name is of kind always."""
        return any(isinstance(candidate.condition, Always) for candidate in self.rules if candidate.name == rule)


@dataclass(frozen=True)
class SettingsContext:
    """The facts that a document is checked against, where they are known: the types' fields, the installed rules and
    reactions, the check of expressions (one problem each, empty when there is none), and why a type cannot be
    subscribed to in ROS here (empty when it can)."""

    layouts: Layouts | None = None
    rules: Collection[str] | None = None
    reactions: Collection[str] | None = None
    check: CheckExpressions | None = field(default=None, compare=False)
    missing_type: Callable[[str], str] | None = field(default=None, compare=False)


def read_detector_settings(
    document: Mapping[str, Any], where: str, knowledge: SettingsContext | None = None
) -> DetectorSettings:
    """Read the document; DocumentError names `where` and all problems.

    Unknown keys are problems, and numbers that JSON has not, wherever they stand."""
    known = knowledge or SettingsContext()
    reader = Reader(where)
    root = reader.keys_of(document)
    name = root.text("name")
    topics = tuple(_topic(item) for item in root.mappings("topics", TOPICS_MAX))
    types = {topic.pattern.text: topic.type for topic in topics}
    rules = root.mappings("rules", RULES_MAX, required=False)
    memory = root.mapping("buffer", required=False)
    settings = DetectorSettings(
        name=name,
        topics=topics,
        rules=read_rules(rules, types, known.layouts, known.rules, known.check),
        reactions=tuple(read_reaction(item) for item in root.mappings("reactions", REACTIONS_MAX, required=False)),
        task=root.text("task", ""),
        state=root.choice("state", STATES, ACTIVE),
        buffer_bytes=memory.whole_number("bytes", PROCESS_BYTES_MIN, PROCESS_BYTES_MAX, PROCESS_BYTES_DEFAULT),
        bag=memory.text("bag", ""),
    )
    if settings.task and not TASK.fullmatch(settings.task):
        root.problem("task", f"{settings.task!r} must be <namespace>/<name>")
    memory.refuse_unknown_keys()
    root.refuse_unknown_keys()
    reader.problems += _cross_problems(settings, known, _unread(rules, settings.rules))
    reported_keys = {problem.partition(": ")[0] for problem in reader.problems}
    numbers = json_problems(document, "")
    reader.problems += [problem for problem in numbers if problem.partition(": ")[0] not in reported_keys]
    reader.finish()
    return settings


def _topic(item: MappingReader) -> TopicSettings:
    bounds = item.mapping("buffer", required=False)
    settings = TopicSettings(
        pattern=read_topic_pattern(item, "name"),
        type=item.text("type"),
        source=item.choice("source", SOURCES, ROS),
        reliability=_chosen(item, "reliability", RELIABILITIES),
        durability=_chosen(item, "durability", DURABILITIES),
        depth=item.whole_number("depth", 1, DEPTH_MAX, DEPTH_DEFAULT),
        deadline_seconds=_given(item, "deadline_seconds"),
        liveliness=_chosen(item, "liveliness", LIVELINESSES),
        liveliness_seconds=_given(item, "liveliness_seconds"),
        stale_seconds=item.number("stale_seconds", SECONDS_MIN, SECONDS_MAX, STALE_SECONDS_DEFAULT),
        expire_seconds=item.number("expire_seconds", 1, SECONDS_MAX, EXPIRE_SECONDS_DEFAULT),
        buffer_seconds=bounds.number("seconds", BUFFER_SECONDS_MIN, BUFFER_SECONDS_MAX, BUFFER_SECONDS_DEFAULT),
        buffer_bytes=bounds.whole_number("bytes", 1, BUFFER_BYTES_MAX, BUFFER_BYTES_DEFAULT),
        buffer_count=bounds.whole_number("count", 1, COUNT_MAX, COUNT_DEFAULT),
        duplicates=bounds.choice("duplicates", (DUPLICATES_DROP, DUPLICATES_KEEP), DUPLICATES_DROP),
        jump=bounds.choice("jump", (JUMP_RESTART, JUMP_KEEP), JUMP_RESTART),
    )
    if settings.type and not ROS_TYPE.fullmatch(settings.type):
        item.problem("type", f"{settings.type!r} is not written like geometry_msgs/msg/PoseStamped")
    if settings.expire_seconds < settings.stale_seconds:
        item.problem("expire_seconds", "must not be less than stale_seconds")
    bounds.refuse_unknown_keys()
    item.refuse_unknown_keys()
    return settings


def _chosen(item: MappingReader, key: str, choices: Sequence[str]) -> str | None:
    return item.choice(key, choices) if item.has(key) else item.value(key)


def _given(item: MappingReader, key: str) -> float | None:
    return item.number(key, SECONDS_MIN, SECONDS_MAX) if item.has(key) else item.value(key)


def _nanoseconds(seconds: float | None) -> int | None:
    return None if seconds is None else int(seconds * 1e9)


def _unread(items: Sequence[MappingReader], rules: Sequence[Rule]) -> Collection[str]:
    """The names of rules that are there, but could not be read."""
    return {str(item.value("name")) for item in items} - {rule.name for rule in rules}


def _cross_problems(settings: DetectorSettings, known: SettingsContext, unread: Collection[str]) -> list[str]:
    """The problems between parts of the settings; parts that could not be read are not reported twice."""
    topics = [topic.pattern.text for topic in settings.topics]
    problems = _repeated("topics", [text for text in topics if text != UNREADABLE_TOPIC])
    problems += _missing_types(settings.topics, known)
    if any(rule.name == TIME_JUMP for rule in settings.rules):
        problems.append(f"rules: the name {TIME_JUMP} is taken by the jumps of topics' time; give the rule another one")
    names = [*sorted(rule.name for rule in settings.rules if not rule.silent), TIME_JUMP]
    silent = [rule.name for rule in settings.rules if rule.silent]
    buffers = {topic.pattern.text: topic.buffer_seconds for topic in settings.topics}
    for index, reaction in enumerate(settings.reactions):
        if reaction.rule in silent:
            problems.append(f"reactions[{index}].rule: {reaction.rule} is silent and gives no events; take silent away")
            continue
        named = [*names, reaction.rule] if reaction.rule in unread or not reaction.rule else names
        sentences = reaction_problems(reaction, named, buffers, known.reactions)
        problems += [f"reactions[{index}].{text}" for text in sentences]
    problems += _repeated(
        "reactions: the operator reaction of rule", [reaction.rule for reaction in settings.operators]
    )
    return problems + _repeated("reactions: the recording", [reaction.recording for reaction in settings.recordings])


def _missing_types(topics: Sequence[TopicSettings], known: SettingsContext) -> Iterator[str]:
    """Problems: types of the ROS graph that this image does not know. One that a message at the broker has may be
    learned from there."""
    for index, topic in enumerate(topics):
        if known.missing_type is not None and topic.source == ROS and ROS_TYPE.fullmatch(topic.type):
            missing = known.missing_type(topic.type)
            if missing:
                yield f"topics[{index}].type: {missing}; {MISSING_TYPE_FIX}"


def _repeated(key: str, names: Sequence[str]) -> list[str]:
    return [f"{key}: {name} stands twice; keep one" for name in sorted({n for n in names if n and names.count(n) > 1})]
