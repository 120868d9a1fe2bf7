"""Settings of the event detector: the document `config.yaml` as values, or every problem in it with key and fix."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from robotkube.domain.errors import DocumentError
from robotkube.domain.message_fields import number_fields
from robotkube.domain.topics import AGENT, TopicPattern

NAME_LENGTH_MAX = 100
TOPICS_MAX = 200
BUFFER_SECONDS_DEFAULT, BUFFER_SECONDS_MAX = 10.0, 600.0
BUFFER_BYTES_DEFAULT, BUFFER_BYTES_MAX = 50_000_000, 1_000_000_000
DEPTH_DEFAULT, DEPTH_MAX = 1000, 100_000
AFTER_SECONDS_MAX = 2.0
STALE_SECONDS_DEFAULT = 1.0
LEASE_SECONDS_MIN, LEASE_SECONDS_MAX = 5, 86_400

T = TypeVar("T")

_NAME = re.compile(r"[a-z0-9]([-.a-z0-9]*[a-z0-9])?")
_TASK = re.compile(r"[a-z0-9]([-a-z0-9]*[a-z0-9])?/[a-z0-9]([-.a-z0-9]*[a-z0-9])?")


@dataclass(frozen=True)
class TopicSettings:
    """A subscription, or one per agent when `pattern` holds `{agent}`, and the bounds of its buffer."""

    pattern: TopicPattern
    type: str
    reliability: str = "reliable"
    durability: str = "volatile"
    depth: int = DEPTH_DEFAULT
    buffer_seconds: float = BUFFER_SECONDS_DEFAULT
    buffer_bytes: int = BUFFER_BYTES_DEFAULT

    @property
    def latched(self) -> bool:
        """Whether a subscriber gets the last messages although it comes later."""
        return self.durability == "transient_local"


@dataclass(frozen=True)
class ProximityRule:
    """Two of `agents` nearer than `start_distance_m` raise an event; farther than `stop_distance_m` ends it.

    Poses whose stamps differ by more than `stale_seconds` are not compared.
    """

    name: str
    agents: tuple[str, ...]
    topic: TopicPattern
    start_distance_m: float
    stop_distance_m: float
    stale_seconds: float = STALE_SECONDS_DEFAULT


@dataclass(frozen=True)
class ThresholdRule:
    """A number in a message beyond `start` raises an event; on the other side of `stop` it ends. `above`: beyond is
    greater, else less."""

    name: str
    topic: TopicPattern
    field: str
    above: bool
    start: float
    stop: float


@dataclass(frozen=True)
class AlwaysRule:
    """Holds from the first moment on."""

    name: str


Rule = ProximityRule | ThresholdRule | AlwaysRule


@dataclass(frozen=True)
class OperatorReaction:
    """A TaskDescription for `application` while the event of `rule` lasts; the text `{agents}` in `parameters` is
    replaced by the list of the event's agents. With `lease_seconds` the task ends when nobody renews it for so long."""

    rule: str
    application: str
    parameters: Mapping[str, Any]
    lease_seconds: int | None = None


@dataclass(frozen=True)
class RecordingReaction:
    """Everything received on the topics goes to storage. `storage`: pattern text -> document | segment; it goes on for
    `after_seconds` once the process is asked to end, so that what is still under way arrives."""

    rule: str
    recording: str
    volume: str
    storage: Mapping[str, str]
    after_seconds: float = 0.0
    trace: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class DetectorSettings:
    """The whole document. `task`: key of the task that launched this detector, empty when none did."""

    name: str
    topics: tuple[TopicSettings, ...]
    rules: tuple[Rule, ...] = ()
    reactions: tuple[OperatorReaction | RecordingReaction, ...] = ()
    task: str = ""

    @property
    def agent(self) -> str:
        """The agent it belongs to: its namespace."""
        return self.name.partition("/")[0]

    @property
    def recordings(self) -> tuple[RecordingReaction, ...]:
        """The recording reactions."""
        return tuple(reaction for reaction in self.reactions if isinstance(reaction, RecordingReaction))

    @property
    def operators(self) -> tuple[OperatorReaction, ...]:
        """The operator reactions."""
        return tuple(reaction for reaction in self.reactions if isinstance(reaction, OperatorReaction))


def read_detector_settings(document: Mapping[str, Any], where: str) -> DetectorSettings:
    """Read the document; DocumentError names `where` and all problems. Unknown keys are problems."""
    problems: list[str] = []
    root = _Fields(document, "", problems)
    settings = DetectorSettings(
        name=root.text("name"),
        topics=tuple(_topic(item) for item in root.items("topics", TOPICS_MAX)),
        rules=tuple(_rule(item) for item in root.items("rules", 100, required=False)),
        reactions=tuple(_reaction(item) for item in root.items("reactions", 100, required=False)),
        task=root.text("task", ""),
    )
    if settings.task and not _TASK.fullmatch(settings.task):
        root.problem("task", f"{settings.task!r} must be <namespace>/<name>")
    root.done()
    if not problems:
        problems += _cross_problems(settings)
    if problems:
        raise DocumentError(where, problems)
    return settings


def _topic(item: _Fields) -> TopicSettings:
    bounds = item.mapping("buffer", required=False)
    settings = TopicSettings(
        pattern=item.pattern("name"),
        type=item.text("type"),
        reliability=item.choice("reliability", ("reliable", "best_effort"), "reliable"),
        durability=item.choice("durability", ("volatile", "transient_local"), "volatile"),
        depth=int(item.number("depth", 1, DEPTH_MAX, DEPTH_DEFAULT)),
        buffer_seconds=bounds.number("seconds", 0.01, BUFFER_SECONDS_MAX, BUFFER_SECONDS_DEFAULT),
        buffer_bytes=int(bounds.number("bytes", 1, BUFFER_BYTES_MAX, BUFFER_BYTES_DEFAULT)),
    )
    bounds.done()
    item.done()
    return settings


def _rule(item: _Fields) -> Rule:
    kind, name = item.choice("kind", ("proximity", "threshold", "always")), item.text("name")
    read = {"proximity": _proximity, "threshold": _threshold}.get(kind)
    rule = read(item, name) if read else AlwaysRule(name)
    item.done()
    return rule


def _proximity(item: _Fields, name: str) -> Rule:
    rule = ProximityRule(
        name=name,
        agents=item.texts("agents", 2),
        topic=item.pattern("topic"),
        start_distance_m=item.number("start_distance_m", 0.001, 1e7),
        stop_distance_m=item.number("stop_distance_m", 0.001, 1e7),
        stale_seconds=item.number("stale_seconds", 0.001, 3600, STALE_SECONDS_DEFAULT),
    )
    if rule.stop_distance_m < rule.start_distance_m:
        item.problem("stop_distance_m", "must not be less than start_distance_m, else every pose would be an edge")
    if AGENT not in rule.topic.text:
        item.problem("topic", f"must hold {AGENT}: the rule compares agents")
    return rule


def _threshold(item: _Fields, name: str) -> Rule:
    """Keys start_above and stop_below, or start_below and stop_above."""
    above = item.has("start_above")
    start, stop = ("start_above", "stop_below") if above else ("start_below", "stop_above")
    rule = ThresholdRule(
        name=name,
        topic=item.pattern("topic"),
        field=item.text("field"),
        above=above,
        start=item.number(start, -1e12, 1e12),
        stop=item.number(stop, -1e12, 1e12),
    )
    if rule.start != rule.stop and (rule.stop > rule.start) == above:
        item.problem(stop, f"must not lie beyond {start}, else every message would be an edge")
    return rule


def _reaction(item: _Fields) -> OperatorReaction | RecordingReaction:
    kind, rule = item.choice("kind", ("operator", "recording")), item.text("rule")
    if kind != "recording":
        parameters = item.plain("parameters")
        application = item.text("application")
        lease = (
            item.number("lease_seconds", LEASE_SECONDS_MIN, LEASE_SECONDS_MAX) if item.has("lease_seconds") else None
        )
        item.done()
        return OperatorReaction(rule, application, parameters, None if lease is None else int(lease))
    storage: dict[str, str] = {}
    for topic in item.items("topics", TOPICS_MAX):
        storage[topic.pattern("name").text] = topic.choice("storage", ("document", "segment"))
        topic.done()
    reaction = RecordingReaction(
        rule=rule,
        recording=item.name("recording"),
        volume=item.name("volume"),
        storage=storage,
        after_seconds=item.number("afterSeconds", 0, AFTER_SECONDS_MAX, 0),
        trace=item.text("trace", ""),
        provenance=item.plain("provenance"),
    )
    item.done()
    return reaction


def _cross_problems(settings: DetectorSettings) -> list[str]:
    problems = _repeated("rules", [rule.name for rule in settings.rules])
    problems += _repeated("topics", [topic.pattern.text for topic in settings.topics])
    kinds = {rule.name: rule for rule in settings.rules}
    topics = {topic.pattern.text: topic for topic in settings.topics}
    for rule in settings.rules:
        problems += [f"rules[{rule.name}].{text}" for text in _rule_problems(rule, topics)]
    for index, reaction in enumerate(settings.reactions):
        problems += [f"reactions[{index}].{text}" for text in _reaction_problems(reaction, kinds, set(topics))]
    return problems


def _rule_problems(rule: Rule, topics: Mapping[str, TopicSettings]) -> Iterator[str]:
    if isinstance(rule, AlwaysRule):
        return
    topic = topics.get(rule.topic.text)
    if topic is None:
        yield f"topic: {rule.topic.text} is not listed under topics; add it there"
    elif isinstance(rule, ThresholdRule) and rule.field not in number_fields(topic.type):
        known = ", ".join(number_fields(topic.type)) or "none that rules can read"
        yield f"field: {topic.type} has no number {rule.field}; it has {known}"


def _reaction_problems(
    reaction: OperatorReaction | RecordingReaction, rules: Mapping[str, Rule], topics: set[str]
) -> list[str]:
    rule = rules.get(reaction.rule)
    if rule is None:
        return [f"rule: there is no rule {reaction.rule}; name one of {', '.join(sorted(rules)) or 'none'}"]
    if isinstance(reaction, OperatorReaction):
        return []
    problems = [] if isinstance(rule, AlwaysRule) else ["rule: a recording reaction needs a rule of kind always"]
    missing = sorted(set(reaction.storage) - topics)
    return problems + [f"topics: {name} is not listed under topics; add it there" for name in missing]


def _repeated(key: str, names: Sequence[str]) -> list[str]:
    return [f"{key}: {name} stands twice; keep one" for name in sorted({n for n in names if names.count(n) > 1})]


class _Fields:
    """Reads the keys of one mapping, collects problems, and knows at the end which keys nobody asked for.

    After a problem the getters return something of the right type: the document is refused anyway.
    """

    def __init__(self, value: object, path: str, problems: list[str]) -> None:
        self._values: Mapping[str, Any] = value if isinstance(value, Mapping) else {}
        self._path, self._problems = path, problems
        self._asked: set[str] = set()
        if not isinstance(value, Mapping):
            problems.append(f"{path or 'the document'}: must be a mapping")

    def problem(self, key: str, text: str) -> None:
        self._problems.append(f"{self._key(key)}: {text}")

    def has(self, key: str) -> bool:
        return key in self._values

    def done(self) -> None:
        for key in sorted(set(self._values) - self._asked):
            self.problem(key, f"unknown key; known are {', '.join(sorted(self._asked))}")

    def text(self, key: str, default: str | None = None) -> str:
        value = self._take(key, default)
        if isinstance(value, str) and (value or default == ""):
            return value
        return self._wrong(key, value, "must be a text that is not empty", "")

    def name(self, key: str) -> str:
        value = self._take(key, None)
        if isinstance(value, str) and len(value) <= NAME_LENGTH_MAX and _NAME.fullmatch(value):
            return value
        return self._wrong(key, value, f"must be a name of at most {NAME_LENGTH_MAX} of a-z, 0-9, - and .", "")

    def choice(self, key: str, choices: Sequence[str], default: str | None = None) -> str:
        value = self._take(key, default)
        if isinstance(value, str) and value in choices:
            return value
        return self._wrong(key, value, f"must be one of {', '.join(choices)}", choices[0])

    def number(self, key: str, least: float, most: float, default: float | None = None) -> float:
        value = self._take(key, default)
        if isinstance(value, (int, float)) and not isinstance(value, bool) and least <= value <= most:
            return value
        return self._wrong(key, value, f"must be a number from {least:g} to {most:g}", least)

    def texts(self, key: str, least: int) -> tuple[str, ...]:
        value = self._take(key, None)
        texts = isinstance(value, list) and all(isinstance(item, str) and item for item in value)
        if texts and len(value) >= least and len(set(value)) == len(value):
            return tuple(value)
        return self._wrong(key, value, f"must be a list of at least {least} different texts", ())

    def pattern(self, key: str) -> TopicPattern:
        text = self.text(key)
        try:
            return TopicPattern(text)
        except ValueError as error:
            if text:
                self.problem(key, str(error))
            return TopicPattern("/unreadable")

    def mapping(self, key: str, required: bool = True) -> _Fields:
        return _Fields(self._take(key, None if required else {}), self._key(key), self._problems)

    def plain(self, key: str) -> Mapping[str, Any]:
        value = self._take(key, {})
        return value if isinstance(value, Mapping) else self._wrong(key, value, "must be a mapping", {})

    def items(self, key: str, most: int, required: bool = True) -> list[_Fields]:
        value = self._take(key, None if required else [])
        if not isinstance(value, list) or len(value) > most or (required and not value):
            return self._wrong(key, value, f"must be a list of {'1' if required else '0'} to {most} mappings", [])
        return [_Fields(item, f"{self._key(key)}[{index}]", self._problems) for index, item in enumerate(value)]

    def _take(self, key: str, default: Any) -> Any:
        self._asked.add(key)
        return self._values.get(key, default)

    def _key(self, key: str) -> str:
        return f"{self._path}.{key}" if self._path else key

    def _wrong(self, key: str, value: object, text: str, instead: T) -> T:
        self.problem(key, f"{'is missing; it ' if value is None else ''}{text}")
        return instead
