"""Reading the rules of a document: every problem with key and fix, all at once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.reader import MappingReader
from robotkube.robots.ros.core.topic_patterns import AGENT, TopicPattern
from robotkube.robots.rules.core.specification import specifications as kinds
from robotkube.robots.rules.core.specification.areas import read_area
from robotkube.robots.rules.core.specification.consistency import cross_problems
from robotkube.robots.rules.core.specification.expressions import CheckExpressions, usable_names
from robotkube.robots.rules.core.specification.specifications import Level, Part, Rule, Timing
from robotkube.robots.rules.core.specification.topic_keys import read_topic_pattern

if TYPE_CHECKING:
    from robotkube.robots.ros.core.cdr_readers.readers import Layouts

RULES_MAX = 100
AGENTS_MAX = 1000
PARTS_MAX = 32
FIELDS_MAX = 32
PLUGIN_TOPICS_MAX = 32
EXPRESSION_LENGTH_MAX = 2000
RULE_NAME_LENGTH_MAX = 200
SECONDS_MAX = 86_400.0
DISTANCE_MIN, DISTANCE_MAX = 0.001, 1e7
VALUE_MAX = 1e12
HZ_MAX, RATE_WINDOW_MAX, RATE_COUNT_MAX = 10_000.0, 600.0, 10_000
LEVELS = (("start_above", "stop_below"), ("start_below", "stop_above"))
RATES = (("start_above_hz", "stop_below_hz"), ("start_below_hz", "stop_above_hz"))


def read_rules(
    items: Sequence[MappingReader],
    topics: Mapping[str, str],
    layouts: Layouts | None = None,
    plugins: Collection[str] | None = None,
    check: CheckExpressions | None = None,
) -> tuple[Rule, ...]:
    """Read the rules; problems go to the reader that `items` belong to, and what is returned then is of no use.

    `topics`: pattern -> type of the document's topics. Fields are looked for in `layouts`, when given; a type that is
    not known there may come with the messages. `plugins`: the names that are installed, None when nobody knows.
    `check` gives the problem of each of some expressions (with the names that it may use), `""` when there is none.
    """
    outcomes = [(item, _rule(item)) for item in items]
    read = [(item, rule) for item, rule in outcomes if rule is not None]
    unread = {str(item.value("name")) for item, rule in outcomes if rule is None}
    for item, rule in read:
        item.refuse_unknown_keys()
        for key, text in cross_problems(rule, [other for _, other in read], topics, layouts, plugins, unread):
            item.problem(key, text)
    if check is not None:
        _check_expressions(read, check)
    return tuple(rule for _, rule in read)


def _check_expressions(read: Sequence[tuple[MappingReader, Rule]], check: CheckExpressions) -> None:
    expressions = [
        (item, key, (text, usable_names(rule.condition, rule.scope)))
        for item, rule in read
        if isinstance(rule.condition, kinds.Cel)
        for key, text in (("expression", rule.condition.expression), ("until", rule.condition.until))
        if text
    ]
    problems = check([expression for _, _, expression in expressions]) if expressions else ()
    for (item, key, _), problem in zip(expressions, problems, strict=True):
        if problem:
            item.problem(key, problem)


def _rule(item: MappingReader) -> Rule | None:
    """A rule, or None when its kind is not known: then nothing else can be said about it."""
    known = item.value("kind") in kinds.KINDS
    kind = item.choice("kind", kinds.KINDS)
    if not known:
        return None
    name = item.text("name")
    if len(name) > RULE_NAME_LENGTH_MAX or not name.isprintable():
        item.problem("name", f"must be at most {RULE_NAME_LENGTH_MAX} characters on one line")
    read = _READERS[kind]
    condition = read(item)
    scope = _scope(item, kind)
    agents = _agents(item, kind, scope)
    grouped = scope == kinds.GROUP and kind != kinds.ALWAYS
    at_least = item.whole_number("at_least", 1, AGENTS_MAX, 1) if grouped else 1
    if agents and at_least > (most := _members_max(kind, len(agents))):
        item.problem("at_least", f"must not be more than {most}: for so many it can hold, of {len(agents)} agents")
    return Rule(
        name=name,
        condition=condition,
        scope=scope,
        agents=agents,
        at_least=at_least,
        timing=_timing(item, kind),
        silent=item.flag("silent", False),
    )


def _members_max(kind: str, agents: int) -> int:
    """The number of members for which a rule of a group can hold: agents, pairs of them, or the group as one."""
    pairs = agents * (agents - 1) // 2
    return {kinds.COMBINATION: 1, kinds.PROXIMITY: pairs, kinds.PYTHON: agents + pairs}.get(kind, agents)


def _scope(item: MappingReader, kind: str) -> str:
    if kind == kinds.ALWAYS:
        return kinds.AGENT
    if kind == kinds.PROXIMITY:
        return item.choice("scope", (kinds.PAIR, kinds.GROUP), kinds.PAIR)
    if kind in (kinds.COMBINATION, kinds.CEL, kinds.PYTHON):
        return item.choice("scope", kinds.SCOPES, kinds.AGENT)
    return item.choice("scope", (kinds.AGENT, kinds.GROUP), kinds.AGENT)


def _agents(item: MappingReader, kind: str, scope: str) -> tuple[str, ...]:
    if kind == kinds.ALWAYS:
        return ()
    needed = kind == {kinds.GROUP: kinds.COMBINATION, kinds.PAIR: kinds.CEL}.get(scope)
    if not needed and not item.has("agents"):
        item.value("agents")
        return ()
    agents = item.texts("agents", 2 if scope == kinds.PAIR or kind == kinds.PROXIMITY else 1)
    for agent in agents:
        if not NAME.fullmatch(agent):
            item.problem("agents", f"{agent!r} is no agent's name: a-z, 0-9 and - in at most 63 letters")
    if len(agents) > AGENTS_MAX:
        item.problem("agents", f"must hold at most {AGENTS_MAX} agents; leave it out to evaluate all of them")
    return agents


def _timing(item: MappingReader, kind: str) -> Timing:
    if kind == kinds.ALWAYS:
        return Timing()
    watches = kind in (kinds.PROXIMITY, kinds.GEOFENCE, kinds.THRESHOLD, kinds.CEL, kinds.PYTHON)
    every = item.number("every_seconds", 0, SECONDS_MAX, 0) if watches else 0.0
    expire = item.number("expire_seconds", 0.1, SECONDS_MAX, kinds.EXPIRE_SECONDS_DEFAULT) if watches else 0.0
    return Timing(
        sustained=item.number("sustained_seconds", 0, SECONDS_MAX, 0),
        minimum_interval=item.number("minimum_interval_seconds", 0, SECONDS_MAX, 0),
        cooldown=item.number("cooldown_seconds", 0, SECONDS_MAX, 0),
        every=every,
        expire=expire,
    )


def _proximity(item: MappingReader) -> kinds.ConditionSettings:
    settings = kinds.Proximity(
        topic=_agents_topic(item),
        start_distance_m=item.number("start_distance_m", DISTANCE_MIN, DISTANCE_MAX),
        stop_distance_m=item.number("stop_distance_m", DISTANCE_MIN, DISTANCE_MAX),
        stale_seconds=item.number("stale_seconds", 0.001, 3600, kinds.STALE_SECONDS_DEFAULT),
        position=item.text("position", "pose.position"),
    )
    if item.has("stop_distance_m") and settings.stop_distance_m < settings.start_distance_m:
        item.problem("stop_distance_m", "must not be less than start_distance_m, else every pose would be an edge")
    return settings


def _agents_topic(item: MappingReader) -> TopicPattern:
    topic = read_topic_pattern(item, "topic")
    if AGENT not in topic.text:
        item.problem("topic", f"must hold {AGENT}: the rule compares agents")
    return topic


def _geofence(item: MappingReader) -> kinds.ConditionSettings:
    return kinds.Geofence(
        topic=read_topic_pattern(item, "topic"),
        polygons=read_area(item.mapping("area")),
        inside=item.choice("when", ("inside", "outside"), "inside") == "inside",
        margin=item.number("margin", 0, DISTANCE_MAX, 0),
        x=item.text("x", "pose.position.x"),
        y=item.text("y", "pose.position.y"),
    )


def _threshold(item: MappingReader) -> kinds.ConditionSettings:
    return kinds.Threshold(
        read_topic_pattern(item, "topic"), item.text("field"), _level(item, LEVELS, -VALUE_MAX, VALUE_MAX)
    )


def _level(item: MappingReader, keys: Sequence[tuple[str, str]], least: float, most: float) -> Level:
    """Read start_above and stop_below, or start_below and stop_above: whichever is there decides."""
    (start, stop), (other, end) = keys
    if not any(item.has(key) for key in (start, stop, other, end)):
        for key in (start, stop, other, end):
            item.value(key)  # known, when a misspelt one is reported
        item.problem(start, f"is missing; it needs {start} and {stop}, or {other} and {end}")
        return Level(True, least, least)
    above = item.has(keys[0][0]) or (item.has(keys[0][1]) and not item.has(keys[1][0]))
    start, stop = keys[0] if above else keys[1]
    level = Level(above, item.number(start, least, most), item.number(stop, least, most))
    if item.has(start) and item.has(stop) and level.start != level.stop and (level.stop > level.start) == above:
        item.problem(stop, f"must not lie beyond {start}, else every message would be an edge")
    return level


def _rate(item: MappingReader) -> kinds.ConditionSettings:
    level = _level(item, RATES, 0.001, HZ_MAX)
    window = item.number("window_seconds", 0.01, RATE_WINDOW_MAX, 2.0)
    if max(level.start, level.stop) * window > RATE_COUNT_MAX:
        item.problem("window_seconds", f"must not let more than {RATE_COUNT_MAX} messages be counted; make it shorter")
    elif not level.above and level.start * window < 1:
        item.problem("window_seconds", "must be long enough for one message at start_below_hz, or use kind absence")
    return kinds.Rate(read_topic_pattern(item, "topic"), level, window)


def _absence(item: MappingReader) -> kinds.ConditionSettings:
    return kinds.Absence(read_topic_pattern(item, "topic"), item.number("seconds", 0.01, SECONDS_MAX))


def _combination(item: MappingReader) -> kinds.ConditionSettings:
    modes = [mode for mode in (kinds.ALL, kinds.ANY, "not", kinds.SEQUENCE) if item.has(mode)]
    if len(modes) != 1:
        item.problem("kind", "a combination needs exactly one of the keys all, any, not and sequence")
        for mode in modes:
            item.value(mode)
        return kinds.Combination(kinds.ALL, ())
    mode = modes[0]
    if mode == "not":
        return kinds.Combination(kinds.ALL, (Part(item.text("not"), negated=True),))
    parts = _parts(item, mode)
    within = item.number("within_seconds", 0.001, SECONDS_MAX) if mode == kinds.SEQUENCE else 0.0
    return kinds.Combination(mode, parts, within)


def _parts(item: MappingReader, mode: str) -> tuple[Part, ...]:
    """Read a list of rules' names; in all and any also `{not: <name>}`."""
    value = item.value(mode)
    if not isinstance(value, list) or not 2 <= len(value) <= PARTS_MAX:
        item.problem(mode, f"must be a list of 2 to {PARTS_MAX} names of rules")
        return ()
    parts = [_part(entry, mode) for entry in value]
    if None in parts:
        words = "names of rules" if mode == kinds.SEQUENCE else "names of rules, or {not: <name>}"
        item.problem(mode, f"must hold {words} and nothing else")
    return tuple(part for part in parts if part is not None)


def _part(entry: Any, mode: str) -> Part | None:
    if isinstance(entry, str) and entry:
        return Part(entry)
    negated = isinstance(entry, Mapping) and list(entry) == ["not"] and mode != kinds.SEQUENCE
    return Part(entry["not"], negated=True) if negated and isinstance(entry["not"], str) and entry["not"] else None


def _cel(item: MappingReader) -> kinds.ConditionSettings:
    return kinds.Cel(
        topic=read_topic_pattern(item, "topic"),
        fields=_variables(item.mapping("fields")),
        expression=_expression(item, "expression", None),
        until=_expression(item, "until", ""),
        stale_seconds=item.number("stale_seconds", 0.001, 3600, kinds.STALE_SECONDS_DEFAULT),
        budget_seconds=item.number("budget_seconds", 0.001, 10, kinds.BUDGET_SECONDS_DEFAULT),
    )


def _expression(item: MappingReader, key: str, default: str | None) -> str:
    text = item.text(key, default)
    if len(text) > EXPRESSION_LENGTH_MAX:
        item.problem(key, f"must be at most {EXPRESSION_LENGTH_MAX} letters long")
    return text


def _variables(item: MappingReader) -> Mapping[str, str]:
    names = item.keys()
    if not 1 <= len(names) <= FIELDS_MAX:
        item.problem("", f"must hold 1 to {FIELDS_MAX} names, each with the path of a field")
    for name in names:
        if not isinstance(name, str) or not name.isidentifier() or not name.isascii() or name in ("agent", "a", "b"):
            item.problem(str(name), "must be a name of letters, digits and _; agent, a and b are taken")
    return {name: item.text(name) for name in names if isinstance(name, str)}


def _python(item: MappingReader) -> kinds.ConditionSettings:
    names = item.texts("topics", 1)
    if len(names) > PLUGIN_TOPICS_MAX:
        item.problem("topics", f"must hold at most {PLUGIN_TOPICS_MAX} topics")
    patterns = []
    for name in names:
        try:
            patterns.append(TopicPattern(name))
        except ValueError as error:
            item.problem("topics", str(error))
    return kinds.Python(
        plugin=item.text("plugin"),
        topics=tuple(patterns),
        settings=item.any_mapping("settings"),
        budget_seconds=item.number("budget_seconds", 0.001, 10, kinds.BUDGET_SECONDS_DEFAULT),
        buffer_seconds=item.number("buffer_seconds", 0.01, 600, kinds.PLUGIN_BUFFER_SECONDS_DEFAULT),
    )


_READERS: Mapping[str, Callable[[MappingReader], kinds.ConditionSettings]] = {
    kinds.PROXIMITY: _proximity,
    kinds.GEOFENCE: _geofence,
    kinds.THRESHOLD: _threshold,
    kinds.RATE: _rate,
    kinds.ABSENCE: _absence,
    kinds.COMBINATION: _combination,
    kinds.CEL: _cel,
    kinds.PYTHON: _python,
    kinds.ALWAYS: lambda item: kinds.Always(),
}
