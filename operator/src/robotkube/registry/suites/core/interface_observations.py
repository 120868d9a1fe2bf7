"""Observations of a running chart's interfaces, and their comparison with what its entry declares."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.reader import Reader
from robotkube.registry.catalogue.core.expected_topics import COMMON_TOPICS, DATABASE, IN, MQTT, OUT, ROS, ExpectedTopic
from robotkube.registry.evidence.core.statements import Check
from robotkube.robots.mqtt.core.client_ids import connection_name
from robotkube.robots.ros.core.graph import Endpoint

CHECKS_MAX = 150
ITEMS_MAX = 2_000
NAME_CHARACTERS_MAX = 120
_KEYS = {
    "endpoints": ("topic", "direction", "type", "reliability", "durability", "node"),
    "publications": ("topic", "qos", "retain", "encoding", "problem"),
    "answers": ("input", "output", "seconds"),
}
_PUBLISHED = re.compile(r"Received PUBLISH from (\S+) \(d\d, q(\d), r(\d), m\d+, '(.*)', \.\.\. \(\d+ bytes\)\)")
_SUBSCRIBED = re.compile(r"(?:\S+: )?(\S+) ([012]) (\S+)")


@dataclass(frozen=True)
class ObservedPublication:
    """A topic, QoS and form in which the chart published to MQTT. `encoding` is empty when the content was not seen;
    `problem` is what is wrong with the content."""

    topic: str
    qos: int
    retain: bool
    encoding: str = ""
    problem: str = ""


@dataclass(frozen=True)
class Subscription:
    """A filter that the chart subscribed to at the broker."""

    filter: str
    qos: int


@dataclass(frozen=True)
class InputResponse:
    """The stimulus of the expected topic at place `input` was followed within `seconds` by something on the one at
    place `output`; None when nothing came."""

    input: int
    output: int | None
    seconds: float


@dataclass(frozen=True)
class Observation:
    """Everything that one set of values opened and did. `seconds`: how long it was observed."""

    endpoints: tuple[Endpoint, ...] = ()
    publications: tuple[ObservedPublication, ...] = ()
    subscriptions: tuple[Subscription, ...] = ()
    collections: tuple[str, ...] = ()
    answers: tuple[InputResponse, ...] = ()
    seconds: float = 0.0


def read_observation(document: Mapping[str, Any], where: str) -> Observation:
    """The observer's last line; DocumentError when it is not what an observer writes."""
    reader = Reader(where)
    root = reader.mapping(document, "", ["seconds", "collections", *_KEYS])
    collections = tuple(str(name) for name in reader.sequence(root.get("collections"), "collections"))
    items = {key: _items(reader, root.get(key), key) for key in _KEYS}
    reader.finish()
    try:
        return Observation(
            endpoints=tuple(Endpoint(**item) for item in items["endpoints"]),
            publications=tuple(ObservedPublication(**item) for item in items["publications"]),
            collections=collections,
            answers=tuple(InputResponse(**item) for item in items["answers"]),
            seconds=float(root["seconds"]),
        )
    except (TypeError, ValueError) as error:
        raise DocumentError(where, [f"is no observation: {error}"]) from error


def _items(reader: Reader, value: Any, key: str) -> list[Mapping[str, Any]]:
    items = reader.sequence(value, key)
    if len(items) > ITEMS_MAX:
        reader.problems.append(f"{key}: {len(items)} are more than {ITEMS_MAX}")
    return [reader.mapping(item, f"{key}[{index}]", _KEYS[key]) for index, item in enumerate(items[:ITEMS_MAX])]


def with_broker_log(observation: Observation, log: str, observer: str) -> Observation:
    """The observation with what the broker's log (mosquitto, all kinds of lines) has of other connections than
    `observer`: subscriptions, and publications that came before the observer did."""
    publications = dict.fromkeys(observation.publications)
    subscriptions: dict[Subscription, None] = {}
    seen = {(item.topic, item.qos, item.retain) for item in publications}
    for line in log.splitlines():
        if (match := _PUBLISHED.search(line)) and connection_name(match[1]) != observer:
            key = (match[4], int(match[2]), match[3] == "1")
            if key not in seen:
                publications[ObservedPublication(*key)] = None
        elif (match := _SUBSCRIBED.fullmatch(line.strip())) and connection_name(match[1]) != observer:
            subscriptions[Subscription(match[3], int(match[2]))] = None
    return replace(observation, publications=tuple(publications), subscriptions=tuple(subscriptions))


def compare(set_name: str, expected: Sequence[ExpectedTopic], observation: Observation) -> list[Check]:
    """One check per expected topic, per deviation, per input's output, and per undeclared topic; at least one."""
    checks = [check for topic in expected for check in _topic_checks(topic, observation)]
    checks += [
        _answer_check(expected, place, observation) for place, topic in enumerate(expected) if topic.direction == IN
    ]
    undeclared = list(_undeclared(expected, observation))
    checks += undeclared or [Check("no undeclared topics", True)]
    return bounded([replace(check, name=f"set {set_name}: {check.name}"[:NAME_CHARACTERS_MAX]) for check in checks])


def bounded(checks: Sequence[Check]) -> list[Check]:
    """At most CHECKS_MAX checks, failed ones before passed ones are left out."""
    if len(checks) <= CHECKS_MAX:
        return list(checks)
    ordered = sorted(checks, key=lambda check: check.passed)
    more = len(checks) - CHECKS_MAX + 1
    failed = any(not check.passed for check in ordered[CHECKS_MAX - 1 :])
    rest = Check(f"{more} more checks", not failed, "left out of the report" if failed else "", "mend the others first")
    return [*ordered[: CHECKS_MAX - 1], rest]


def _topic_checks(topic: ExpectedTopic, seen: Observation) -> list[Check]:
    kinds = {ROS: _ros_problems, MQTT: _mqtt_problems, DATABASE: _database_problems}
    problems = list(kinds[topic.medium](topic, seen))
    if not problems:
        return [Check(topic.title, True)]
    return [Check(f"{topic.title}: {what}", False, problem, fix) for what, problem, fix in problems]


def _ros_problems(topic: ExpectedTopic, seen: Observation) -> Iterator[tuple[str, str, str]]:
    doing, noun = ("publishes to", "publisher") if topic.direction == OUT else ("subscribes to", "subscription")
    endpoints = [e for e in seen.endpoints if e.direction == topic.direction and topic.matches(e.topic)]
    if not endpoints:
        problem = f"in {seen.seconds:.0f} s no node of the chart had a {noun} of {topic.topic}"
        others = sorted({e.topic for e in seen.endpoints if e.direction == topic.direction})
        problem += f"; it {doing} {', '.join(others[:5]) or 'nothing'}"
        yield "declared but absent", problem, f"open it, or correct interface {topic.interface} in the entry"
    types = sorted({e.type for e in endpoints} - {topic.type})
    if types:
        fix = f"use {topic.type}, or declare type {types[0]} in interface {topic.interface}"
        yield "wrong type", f"it {doing} it as {', '.join(types)}, declared is {topic.type}", fix
    for key in ("reliability", "durability"):
        declared = getattr(topic, key)
        values = sorted({str(getattr(e, key)) for e in endpoints} - {declared})
        if values:
            fix = f"open it {declared}, or declare qos.{key}: {values[0]} in interface {topic.interface}"
            yield f"wrong {key}", f"its {noun} is {', '.join(values)}, declared is {declared}", fix


def _mqtt_problems(topic: ExpectedTopic, seen: Observation) -> Iterator[tuple[str, str, str]]:
    kinds = _mqtt_out_problems if topic.direction == OUT else _mqtt_in_problems
    return kinds(topic, seen)


def _mqtt_out_problems(topic: ExpectedTopic, seen: Observation) -> Iterator[tuple[str, str, str]]:
    published = [item for item in seen.publications if topic.matches(item.topic)]
    where = f"interface {topic.interface}"
    if not published:
        others = sorted({item.topic for item in seen.publications})
        problem = f"in {seen.seconds:.0f} s nothing was published to {topic.topic}"
        problem += f"; it published to {', '.join(others[:5]) or 'nothing'}"
        yield "declared but absent", problem, f"publish to it, or correct {where} in the entry"
    levels = sorted({item.qos for item in published} - {topic.qos})
    if levels:
        problem = f"it is published with QoS {', '.join(map(str, levels))}, declared is {topic.qos}"
        yield "wrong QoS", problem, f"publish with QoS {topic.qos}, or declare qos.qos: {levels[0]} in {where}"
    if any(item.retain != topic.retain for item in published):
        words = ("without", "with") if topic.retain else ("with", "without")
        problem = f"it is published {words[0]} the retain flag, declared is {words[1]} it"
        yield (
            "wrong retain flag",
            problem,
            f"change the flag, or declare qos.retain: {_word(not topic.retain)} in {where}",
        )
    forms = sorted({item.encoding for item in published} - {topic.encoding, ""})
    if forms:
        problem = f"its content is {', '.join(forms)}, declared is {topic.encoding}"
        yield "wrong encoding", problem, f"write {topic.encoding}, or declare the other encoding in {where}"
    problems = sorted({item.problem for item in published if item.problem})
    if problems:
        yield "wrong type", f"its messages are no {topic.type}: {problems[0]}", f"correct the type in {where}"


def _mqtt_in_problems(topic: ExpectedTopic, seen: Observation) -> Iterator[tuple[str, str, str]]:
    subscribed = [item for item in seen.subscriptions if topic.matches(item.filter)]
    where = f"interface {topic.interface}"
    if not subscribed:
        others = sorted({item.filter for item in seen.subscriptions})
        problem = (
            f"the broker saw no subscription of {topic.topic}; it subscribed to {', '.join(others[:5]) or 'nothing'}"
        )
        yield "declared but absent", problem, f"subscribe to it, or correct {where} in the entry"
    levels = sorted({item.qos for item in subscribed} - {topic.qos})
    if levels:
        problem = f"it is subscribed with QoS {', '.join(map(str, levels))}, declared is {topic.qos}"
        yield "wrong QoS", problem, f"subscribe with QoS {topic.qos}, or declare qos.qos: {levels[0]} in {where}"


def _database_problems(topic: ExpectedTopic, seen: Observation) -> Iterator[tuple[str, str, str]]:
    if topic.direction == OUT and not any(topic.matches(name) for name in seen.collections):
        problem = f"there is no collection {topic.topic}; the database has {', '.join(seen.collections[:5]) or 'none'}"
        yield "declared but absent", problem, f"write to it, or correct interface {topic.interface} in the entry"


def _answer_check(expected: Sequence[ExpectedTopic], place: int, seen: Observation) -> Check:
    topic = expected[place]
    name = f"{topic.title} leads to an output"
    outputs = [other for other in expected if other.direction == OUT and other.interface == topic.causes]
    answer = next((answer for answer in seen.answers if answer.input == place), None)
    if answer is not None and answer.output is not None:
        return Check(name, True)
    where = ", ".join(other.title for other in outputs[:5]) or "nothing that the values give"
    waited = f"in {answer.seconds:.0f} s " if answer else ""
    kind = topic.type or topic.encoding or "document"
    problem = f"after messages ({kind}) were sent to {topic.example} nothing was seen {waited}on {where}"
    fix = f"use the input, or correct `causes` of interface {topic.interface}; a default {kind} must be enough"
    return Check(name, False, problem, fix)


def _undeclared(expected: Sequence[ExpectedTopic], seen: Observation) -> Iterator[Check]:
    fix = "declare it as an interface in the entry, or do not open it"
    for endpoint in dict.fromkeys((e.topic, e.direction, e.type) for e in seen.endpoints):
        topic, direction, kind = endpoint
        if COMMON_TOPICS.get((topic, direction)) == kind or _declared(expected, ROS, direction, topic):
            continue
        doing = "publishes" if direction == OUT else "subscribes to"
        nodes = {e.node for e in seen.endpoints if (e.topic, e.direction, e.type) == endpoint} - {""}
        problem = (
            f"node {', '.join(sorted(nodes)) or 'without a name'} {doing} {topic} ({kind}), which no interface declares"
        )
        yield Check(f"undeclared topic {ROS} {direction} {topic}", False, problem, fix)
    yield from _undeclared_elsewhere(expected, seen, fix)


def _undeclared_elsewhere(expected: Sequence[ExpectedTopic], seen: Observation, fix: str) -> Iterator[Check]:
    names: Iterable[tuple[str, str, str, str]] = [
        *((MQTT, OUT, item.topic, "was published") for item in seen.publications),
        *((MQTT, IN, item.filter, "was subscribed") for item in seen.subscriptions),
        *((DATABASE, OUT, name, "was made") for name in seen.collections),
    ]
    for medium, direction, name, what in dict.fromkeys(names):
        if not _declared(expected, medium, direction, name):
            noun = "collection" if medium == DATABASE else "topic"
            problem = f"{noun} {name} {what}, which no interface declares"
            yield Check(f"undeclared {noun} {medium} {direction} {name}", False, problem, fix)


def _declared(expected: Sequence[ExpectedTopic], medium: str, direction: str, name: str) -> bool:
    directions = (IN, OUT) if medium == DATABASE else (direction,)
    return any(t.medium == medium and t.direction in directions and t.matches(name) for t in expected)


def _word(value: bool) -> str:
    return "true" if value else "false"
