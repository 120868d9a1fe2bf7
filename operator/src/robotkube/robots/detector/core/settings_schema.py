"""The settings of the event detector as JSON Schema (draft 7), which editors and `helm` check before a detector reads
them. `make reference` writes it into the chart.

The reader refuses whatever the schema refuses. It alone finds names that stand for nothing, topics that are not listed,
and windows that are longer than their buffer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.foundation.documents.core.patterns import (
    MQTT_TOPIC,
    ROS_TYPE,
    SECRET_KEY,
    SUBDOMAIN,
    TASK,
    anchored,
    anchored_or_empty,
)
from robotkube.foundation.documents.core.reader import NAME_LENGTH_MAX
from robotkube.robots.detector.core import settings as settings
from robotkube.robots.reactions.core import settings as reactions
from robotkube.robots.ros.core.qos import DURABILITIES, LIVELINESSES, RELIABILITIES
from robotkube.robots.ros.core.ring_buffers import (
    COUNT_DEFAULT,
    DUPLICATES_DROP,
    DUPLICATES_KEEP,
    JUMP_KEEP,
    JUMP_RESTART,
)
from robotkube.robots.rules.core.specification.json_schema import (
    TOPIC_PATTERN,
    Schema,
    choice,
    number,
    rules_schema,
    text,
)

TYPE_PATTERN = anchored(ROS_TYPE)
NAME_PATTERN = anchored(SUBDOMAIN)
TASK_PATTERN = anchored_or_empty(TASK)


def detector_schema() -> dict[str, Schema]:
    """The schemas of the settings by key, each of which stands by itself; `name` is the release's and not among
    them."""
    return {
        "topics": _topics(),
        "rules": rules_schema(),
        "reactions": _reactions(),
        "task": {
            "type": "string",
            "pattern": TASK_PATTERN,
            "description": "Key of the task that launched this detector, <namespace>/<name>; what it asks for "
            "belongs to that task's chain. Empty: none did.",
        },
        "state": choice(settings.STATES, _STATE, settings.ACTIVE),
        "buffer": _mapping("What all buffers share.", _PROCESS_BUFFER),
    }


_STATE = (
    "active: everything at work. buffering: subscribed, buffers filled, no rule evaluated. inactive: subscribed to "
    "nothing, ready to go."
)


def _whole(least: int, most: int, description: str, default: int | None = None) -> Schema:
    schema: Schema = {"type": "integer", "minimum": least, "maximum": most, "description": description}
    return schema if default is None else {**schema, "default": default}


def _mapping(description: str, properties: Mapping[str, Schema], required: Sequence[str] = ()) -> Schema:
    schema: Schema = {"type": "object", "description": description, "additionalProperties": False}
    return {**schema, **({"required": list(required)} if required else {}), "properties": dict(properties)}


def _seconds(description: str, default: float | None = None) -> Schema:
    return number(settings.SECONDS_MIN, settings.SECONDS_MAX, description, default)


_TOPIC_NAME = text("ROS topic; {agent} stands for any agent's ROS name.", pattern=TOPIC_PATTERN)

_PROCESS_BUFFER: Mapping[str, Schema] = {
    "bytes": _whole(
        settings.PROCESS_BYTES_MIN,
        settings.PROCESS_BYTES_MAX,
        "Serialised size of all buffers together; beyond it the fullest one loses its oldest message.",
        settings.PROCESS_BYTES_DEFAULT,
    ),
    "bag": {"type": "string", "default": "", "description": "Path of a bag that fills the buffers at the start."},
}

_TOPIC_BUFFER: Mapping[str, Schema] = {
    "seconds": number(
        settings.BUFFER_SECONDS_MIN,
        settings.BUFFER_SECONDS_MAX,
        "Age of the oldest message, by stamp.",
        settings.BUFFER_SECONDS_DEFAULT,
    ),
    "bytes": _whole(1, settings.BUFFER_BYTES_MAX, "Serialised size.", settings.BUFFER_BYTES_DEFAULT),
    "count": _whole(1, settings.COUNT_MAX, "Number of messages.", COUNT_DEFAULT),
    "duplicates": choice((DUPLICATES_DROP, DUPLICATES_KEEP), "Equal messages of one stamp.", DUPLICATES_DROP),
    "jump": choice(
        (JUMP_RESTART, JUMP_KEEP),
        "When time jumps (a simulation, a bag from its begin). restart: the buffer begins anew. keep: it stays.",
        JUMP_RESTART,
    ),
}

_TOPIC: Mapping[str, Schema] = {
    "name": _TOPIC_NAME,
    "type": text("ROS message type, such as geometry_msgs/msg/PoseStamped.", pattern=TYPE_PATTERN),
    "source": choice(settings.SOURCES, "ros, or mqtt: straight from the broker, topic mqtt/<name>.", settings.ROS),
    "reliability": choice(RELIABILITIES, "ROS reliability; without it reliable if all publishers are."),
    "durability": choice(
        DURABILITIES,
        "ROS durability; without it transient_local if all publishers are. transient_local: the topic speaks once, so "
        "its buffer has no window and is in every recording.",
    ),
    "depth": _whole(1, settings.DEPTH_MAX, "ROS history depth, our own.", settings.DEPTH_DEFAULT),
    "deadline_seconds": _seconds("ROS deadline; without it the longest that the publishers promise, if all do."),
    "liveliness": choice(LIVELINESSES, "ROS liveliness; without it manual_by_topic if all publishers are."),
    "liveliness_seconds": _seconds("Lease of the liveliness; without it the longest that the publishers promise."),
    "stale_seconds": _seconds("Without a message for so long it counts as stale.", settings.STALE_SECONDS_DEFAULT),
    "expire_seconds": number(
        1,
        settings.SECONDS_MAX,
        "A topic that {agent} found is forgotten after so long without a message.",
        settings.EXPIRE_SECONDS_DEFAULT,
    ),
    "buffer": _mapping("Bounds of the ring buffer; the first one reached counts.", _TOPIC_BUFFER),
}


def _topics() -> Schema:
    return {
        "type": "array",
        "maxItems": settings.TOPICS_MAX,
        "description": "Topics to buffer.",
        "items": _mapping("One topic or pattern.", _TOPIC, ("name", "type")),
    }


_WINDOW = (0, reactions.WINDOW_SECONDS_MAX)
_RECORDED: Mapping[str, Schema] = {
    "name": _TOPIC_NAME,
    "storage": choice(
        ("document", "segment"),
        "document: in the database. segment: in an MCAP file, referenced by the database.",
    ),
    "before_seconds": number(*_WINDOW, "How long before the event's start, from the buffer.", 0),
    "after_seconds": number(*_WINDOW, "How long after the event's end.", 0),
}
_TIMEOUT = number(
    reactions.TIMEOUT_SECONDS_MIN,
    reactions.TIMEOUT_SECONDS_MAX,
    "webhook, python: how long an answer is waited for.",
    reactions.TIMEOUT_SECONDS_DEFAULT,
)

_REACTION: Mapping[str, Schema] = {
    "rule": text("Name of the rule; time-jump stands for jumps of a topic's time."),
    "kind": choice(
        reactions.KINDS,
        "operator: asks for an application while the event lasts. recording: stores topics. webhook, mqtt: tells of "
        "start and end. python: what an installed package does.",
    ),
    "application": text("operator: application of the catalogue."),
    "parameters": {
        "type": "object",
        "description": "operator: parameters of the application, any keys; {agents} stands for the event's agents.",
        "additionalProperties": True,
    },
    "lease_seconds": _whole(
        reactions.LEASE_SECONDS_MIN,
        reactions.LEASE_SECONDS_MAX,
        "operator: the task ends when the detector has not renewed it for so long; without it, when the event ends.",
    ),
    "recording": text("recording: its name.", pattern=NAME_PATTERN, maxLength=NAME_LENGTH_MAX),
    "volume": text("recording: name of the claim, for the index.", pattern=NAME_PATTERN, maxLength=NAME_LENGTH_MAX),
    "topics": {
        "type": "array",
        "minItems": 1,
        "maxItems": reactions.TOPICS_MAX,
        "description": "recording: what is stored.",
        "items": _mapping("One topic.", _RECORDED, ("name", "storage")),
    },
    "afterSeconds": number(
        0,
        reactions.AFTER_SECONDS_MAX,
        "recording: how long it goes on once its pod is asked to end; the pod's grace must hold it.",
        0,
    ),
    "trace": {"type": "string", "description": "recording: identifier that goes with the event."},
    "provenance": {
        "type": "object",
        "description": "recording: why it was made and by what (task, event, rule, trace, charts, ...).",
        "additionalProperties": True,
    },
    "url": text("webhook: http(s)://host[:port]/path, without an account in it.", pattern="^https?://[^@\\s]+$"),
    "secret": {
        "type": "string",
        "pattern": anchored_or_empty(SECRET_KEY),
        "description": "webhook: key in the Secret `webhooks.existingSecret` that signs; empty: not signed.",
    },
    "topic": text("mqtt: full name of the topic at the broker.", pattern=anchored(MQTT_TOPIC)),
    "retained": {"type": "boolean", "default": False, "description": "mqtt: the broker keeps the last message."},
    "plugin": text("python: name in the entry point group robotkube.reactions of an installed package."),
    "settings": {
        "type": "object",
        "description": "python: what the package's reaction wants to know, any keys.",
        "additionalProperties": True,
    },
    "timeout_seconds": _TIMEOUT,
    "retry_seconds": number(
        0,
        reactions.RETRY_SECONDS_MAX,
        "webhook, mqtt, python: how long it is tried again; afterwards a dead letter.",
        reactions.RETRY_SECONDS_DEFAULT,
    ),
}

_KINDS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    reactions.OPERATOR: (("application",), ("parameters", "lease_seconds")),
    reactions.RECORDING: (("recording", "volume", "topics"), ("afterSeconds", "trace", "provenance")),
    reactions.WEBHOOK: (("url",), ("secret", "timeout_seconds", "retry_seconds")),
    reactions.MQTT: (("topic",), ("retained", "retry_seconds")),
    reactions.PYTHON: (("plugin",), ("settings", "timeout_seconds", "retry_seconds")),
}
"""The keys of each kind: those it needs, those it may have."""


def _reactions() -> Schema:
    reaction = _mapping("One reaction.", _REACTION, ("rule", "kind"))
    return {
        "type": "array",
        "maxItems": settings.REACTIONS_MAX,
        "description": "Reactions to rules.",
        "items": {**reaction, "allOf": [_condition(name, *keys) for name, keys in _KINDS.items()]},
    }


def _condition(kind: str, required: Sequence[str], optional: Sequence[str]) -> dict[str, Any]:
    keys = sorted(("rule", "kind", *required, *optional))
    return {
        "if": {"required": ["kind"], "properties": {"kind": {"const": kind}}},
        "then": {"required": list(required), "propertyNames": {"enum": keys}},
    }
