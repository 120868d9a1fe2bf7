"""Settings of reactions: the list `reactions` of a detector's settings as values.

Named tuples, since dataclasses cost a millisecond each at every start.
"""

from __future__ import annotations

import hashlib
import ipaddress
import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from robotkube.foundation.documents.core.patterns import HOST_LABEL, MQTT_TOPIC, SECRET_KEY, WEBHOOK_URL
from robotkube.foundation.documents.core.reader import MappingReader
from robotkube.robots.ros.core.topic_patterns import UNREADABLE_TOPIC, TopicPattern
from robotkube.robots.rules.core.specification.topic_keys import read_topic_pattern

OPERATOR, RECORDING, WEBHOOK, MQTT, PYTHON = "operator", "recording", "webhook", "mqtt", "python"
KINDS = (OPERATOR, RECORDING, WEBHOOK, MQTT, PYTHON)

NOTHING: Mapping[str, Any] = MappingProxyType({})
TOPICS_MAX = 200
LEASE_SECONDS_MIN, LEASE_SECONDS_MAX = 5, 86_400
AFTER_SECONDS_MAX = 2.0
WINDOW_SECONDS_MAX = 600.0
TIMEOUT_SECONDS_DEFAULT, TIMEOUT_SECONDS_MIN, TIMEOUT_SECONDS_MAX = 5.0, 0.1, 60.0
RETRY_SECONDS_DEFAULT, RETRY_SECONDS_MAX = 600.0, 86_400.0
PORT_MAX = 65_535
HOST_LETTERS_MAX = 253


class OperatorReactionSettings(NamedTuple):
    """A TaskDescription for `application` while the event of `rule` lasts; the text `{agents}` in `parameters` is
    replaced by the list of the event's agents. With `lease_seconds` the task ends when nobody renews it for so long."""

    rule: str
    application: str
    parameters: Mapping[str, Any]
    lease_seconds: int | None = None


class RecordingTopic(NamedTuple):
    """A topic to record. `storage`: document | segment; the seconds before an event's start and after its end."""

    pattern: TopicPattern
    storage: str
    before_seconds: float = 0.0
    after_seconds: float = 0.0


class RecordingReactionSettings(NamedTuple):
    """What is received on the topics goes to storage: around the events of `rule`, or all of it when that is of kind
    always. It goes on for `after_seconds` once the process is asked to end, so that what is under way arrives."""

    rule: str
    recording: str
    volume: str
    topics: tuple[RecordingTopic, ...]
    after_seconds: float = 0.0
    trace: str = ""
    provenance: Mapping[str, Any] = NOTHING


class WebhookReactionSettings(NamedTuple):
    """A signed POST to `url` for every edge. `secret`: key of the mounted Secret `webhooks`, empty for no signature."""

    rule: str
    url: str
    secret: str = ""
    timeout_seconds: float = TIMEOUT_SECONDS_DEFAULT
    retry_seconds: float = RETRY_SECONDS_DEFAULT

    @property
    def name(self) -> str:
        """The name in status and metrics: whatever the URL may hold besides its host is nobody's business."""
        address = WEBHOOK_URL.fullmatch(self.url)
        return f"webhook {self.rule} {address['host'] if address else ''}".rstrip()

    @property
    def key(self) -> str:
        """The key in the delivery journal, the same as long as the same receiver is notified of the same rule."""
        return _digest(WEBHOOK, self.rule, self.url)


class MqttReactionSettings(NamedTuple):
    """A message on the broker's topic `topic` for every edge, QoS 1. `retained`: the broker keeps the last one."""

    rule: str
    topic: str
    retained: bool = False
    retry_seconds: float = RETRY_SECONDS_DEFAULT

    @property
    def name(self) -> str:
        """The name in status and metrics."""
        return f"mqtt {self.rule} {self.topic}"

    @property
    def key(self) -> str:
        """The key in the delivery journal, the same as long as the same topic is notified of the same rule."""
        return _digest(MQTT, self.rule, self.topic)


class PythonReactionSettings(NamedTuple):
    """A reaction of an installed package, by its name in the entry point group `robotkube.reactions`."""

    rule: str
    plugin: str
    settings: Mapping[str, Any] = NOTHING
    timeout_seconds: float = TIMEOUT_SECONDS_DEFAULT
    retry_seconds: float = RETRY_SECONDS_DEFAULT

    @property
    def name(self) -> str:
        """The name in status and metrics."""
        return f"python {self.rule} {self.plugin}"

    @property
    def key(self) -> str:
        """The key in the delivery journal, the same as long as the same package reacts to the same rule with the same
        settings."""
        return _digest(PYTHON, self.rule, self.plugin, json.dumps(self.settings, sort_keys=True, default=str))


def _digest(*texts: str) -> str:
    """The digest of a reaction's settings, so that what an address may hold beside its host stands nowhere."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:32]


DeliveryReactionSettings = WebhookReactionSettings | MqttReactionSettings | PythonReactionSettings
ReactionSettings = OperatorReactionSettings | RecordingReactionSettings | DeliveryReactionSettings


def read_reaction(item: MappingReader) -> ReactionSettings:
    """Read one reaction; its problems go to the reader that `item` belongs to."""
    kind = item.choice("kind", KINDS)
    rule = item.text("rule")
    reaction = _READERS[kind](item, rule)
    item.refuse_unknown_keys()
    return reaction


def reaction_problems(
    reaction: ReactionSettings, rules: Sequence[str], buffers: Mapping[str, float], plugins: Collection[str] | None
) -> Iterator[str]:
    """The problems of a reaction beside the rest of the settings. `rules`: names; `buffers`: topic pattern -> seconds
    it holds; `plugins`: the installed reactions, None when nobody knows."""
    if reaction.rule not in rules:
        yield f"rule: there is no rule {reaction.rule}; name one of {', '.join(rules)}"
    if isinstance(reaction, PythonReactionSettings) and plugins is not None and reaction.plugin not in plugins:
        known = ", ".join(sorted(plugins)) or "none"
        yield f"plugin: no installed package offers the reaction {reaction.plugin}; there are: {known}"
    if not isinstance(reaction, RecordingReactionSettings):
        return
    for topic in reaction.topics:
        if UNREADABLE_TOPIC in (topic.pattern.text, *buffers):
            continue  # reported already, and what it was meant to be nobody knows
        seconds = buffers.get(topic.pattern.text)
        if seconds is None:
            yield f"topics: {topic.pattern.text} is not listed under topics; add it there"
        elif topic.before_seconds > seconds:
            short = f"{topic.pattern.text} has before_seconds {topic.before_seconds:g}, its buffer {seconds:g} s"
            yield f"topics: {short}; make buffer.seconds longer"


def _operator(item: MappingReader, rule: str) -> ReactionSettings:
    lease = item.has("lease_seconds")
    seconds = item.whole_number(
        "lease_seconds", LEASE_SECONDS_MIN, LEASE_SECONDS_MAX, None if lease else LEASE_SECONDS_MIN
    )
    parameters = item.any_mapping("parameters")
    application = item.text("application")
    return OperatorReactionSettings(rule, application, parameters, seconds if lease else None)


def _recording(item: MappingReader, rule: str) -> ReactionSettings:
    topics = tuple(_recording_topic(topic) for topic in item.mappings("topics", TOPICS_MAX))
    return RecordingReactionSettings(
        rule=rule,
        recording=item.name("recording"),
        volume=item.name("volume"),
        topics=topics,
        after_seconds=item.number("afterSeconds", 0, AFTER_SECONDS_MAX, 0),
        trace=item.text("trace", ""),
        provenance=item.any_mapping("provenance"),
    )


def _recording_topic(item: MappingReader) -> RecordingTopic:
    topic = RecordingTopic(
        read_topic_pattern(item, "name"),
        item.choice("storage", ("document", "segment")),
        item.number("before_seconds", 0, WINDOW_SECONDS_MAX, 0),
        item.number("after_seconds", 0, WINDOW_SECONDS_MAX, 0),
    )
    item.refuse_unknown_keys()
    return topic


def _webhook(item: MappingReader, rule: str) -> ReactionSettings:
    url = item.text("url")
    secret = item.text("secret", "")
    if problem := _address_problem(url):
        item.problem("url", problem)
    if secret and not SECRET_KEY.fullmatch(secret):
        item.problem("secret", "must be the name of a key in the mounted Secret webhooks, never the secret itself")
    return WebhookReactionSettings(rule, url, secret, _timeout(item), _retry(item))


def _address_problem(url: str) -> str:
    """The problem of an address, empty when there is none; that it is missing was reported already."""
    address = WEBHOOK_URL.fullmatch(url)
    if not address:
        return "must be an address such as https://host:port/path, without an account in it" if url else ""
    if address["port"] and int(address["port"]) > PORT_MAX:
        return f"must have a port from 1 to {PORT_MAX}, not {address['port']}"
    if not _is_host(address["host"]):
        return (
            f"{address['host']} is no host: a name of labels of at most 63 letters with dots between, or an IP address"
        )
    return ""


def _is_host(text: str) -> bool:
    name = text.removesuffix(".")
    if not text.startswith("[") and not name.replace(".", "").isdigit():
        return len(name) <= HOST_LETTERS_MAX and all(HOST_LABEL.fullmatch(label) for label in name.split("."))
    try:
        return bool(ipaddress.ip_address(text.strip("[]")))
    except ValueError:
        return False


def _mqtt(item: MappingReader, rule: str) -> ReactionSettings:
    topic = item.text("topic")
    if topic and not MQTT_TOPIC.fullmatch(topic):
        item.problem("topic", "must be the full name of an MQTT topic such as events/near, without + and #")
    return MqttReactionSettings(rule, topic, item.flag("retained", False), _retry(item))


def _python(item: MappingReader, rule: str) -> ReactionSettings:
    return PythonReactionSettings(rule, item.text("plugin"), item.any_mapping("settings"), _timeout(item), _retry(item))


def _timeout(item: MappingReader) -> float:
    return item.number("timeout_seconds", TIMEOUT_SECONDS_MIN, TIMEOUT_SECONDS_MAX, TIMEOUT_SECONDS_DEFAULT)


def _retry(item: MappingReader) -> float:
    return item.number("retry_seconds", 0, RETRY_SECONDS_MAX, RETRY_SECONDS_DEFAULT)


_READERS: Mapping[str, Callable[[MappingReader, str], ReactionSettings]] = {
    OPERATOR: _operator,
    RECORDING: _recording,
    WEBHOOK: _webhook,
    MQTT: _mqtt,
    PYTHON: _python,
}
