"""Checks of a rule against the other rules, the document's topics, the messages' fields and the installed packages."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from robotkube.robots.ros.core.cdr_readers.readers import NUMBER, TRUTH, UnknownTypeError
from robotkube.robots.ros.core.topic_patterns import AGENT, UNREADABLE_TOPIC
from robotkube.robots.rules.core.specification.specifications import (
    ALL,
    ANY,
    GROUP,
    PAIR,
    SEQUENCE,
    Always,
    Cel,
    Combination,
    Geofence,
    Proximity,
    Python,
    Rule,
    paths,
)

if TYPE_CHECKING:
    from robotkube.robots.ros.core.cdr_readers.readers import Layouts

WORKERS_MAX = 16
PAIR_AGENTS_MAX = 32

Problem = tuple[str, str]
"""Key and sentence."""


def cross_problems(
    rule: Rule,
    rules: Sequence[Rule],
    topics: Mapping[str, str],
    layouts: Layouts | None,
    plugins: Collection[str] | None,
    unread: Collection[str] = (),
) -> Iterator[Problem]:
    """The problems of `rule` beside the others; `unread`: names of rules of which nothing else is known."""
    by_name = {other.name: other for other in rules}
    if rule.name and sum(other.name == rule.name for other in rules) > 1:
        yield "name", f"{rule.name} is the name of another rule, too; give each its own"
    yield from _topic_problems(rule, topics, layouts)
    yield from _worker_problems(rule, rules, plugins)
    if isinstance(rule.condition, Combination):
        yield from _combination_problems(rule, rule.condition, by_name, unread)


def _topic_problems(rule: Rule, topics: Mapping[str, str], layouts: Layouts | None) -> Iterator[Problem]:
    key = "topics" if isinstance(rule.condition, Python) else "topic"
    for topic in rule.topics:
        if topic.text not in topics:
            if topic.text != UNREADABLE_TOPIC:
                yield key, f"{topic.text} is not listed under topics; add it there"
        elif layouts is not None:
            yield from _field_problems(rule, topics[topic.text], layouts)
    if isinstance(rule.condition, Cel) and rule.scope == PAIR:
        if AGENT not in rule.condition.topic.text:
            yield "topic", f"must hold {AGENT}: the rule compares agents"
        if len(rule.agents) > PAIR_AGENTS_MAX:
            yield "agents", f"must hold at most {PAIR_AGENTS_MAX} agents for an expression over each two of them"


def _field_problems(rule: Rule, type_name: str, layouts: Layouts) -> Iterator[Problem]:
    numbers = not isinstance(rule.condition, Cel)
    for path in paths(rule):
        try:
            (kind,) = layouts.reader(type_name, (path,)).kinds
        except UnknownTypeError:
            return  # the type's definition may come with the messages
        except ValueError as error:
            yield _field_key(rule, path), str(error)
            continue
        if numbers and kind not in (NUMBER, TRUTH):
            yield _field_key(rule, path), f"{path} of {type_name} is no number"


def _field_key(rule: Rule, path: str) -> str:
    match rule.condition:
        case Cel():
            return "fields"
        case Proximity():
            return "position"
        case Geofence() as settings:
            return "x" if path == settings.x else "y"
    return "field"


def _worker_problems(rule: Rule, rules: Sequence[Rule], plugins: Collection[str] | None) -> Iterator[Problem]:
    if not isinstance(rule.condition, (Cel, Python)):
        return
    if sum(isinstance(other.condition, (Cel, Python)) for other in rules) > WORKERS_MAX:
        yield "kind", f"at most {WORKERS_MAX} rules of kinds cel and python: each has a process of its own"
    if isinstance(rule.condition, Python) and plugins is not None and rule.condition.plugin not in plugins:
        known = ", ".join(sorted(plugins)) or "none"
        yield "plugin", f"no installed package offers the rule {rule.condition.plugin}; there are: {known}"


def _combination_problems(
    rule: Rule, condition: Combination, by_name: Mapping[str, Rule], unread: Collection[str]
) -> Iterator[Problem]:
    key = condition.mode if condition.parts else "kind"
    if len(condition.parts) == 1:
        key = "not"
    missing = [part.rule for part in condition.parts if part.rule not in by_name]
    for name in missing:
        if name and name not in unread:
            yield key, f"there is no rule {name}; name one of {', '.join(sorted(by_name))}"
    if _reaches(rule, rule.name, by_name):
        yield key, "the rule looks at itself, perhaps by way of others; take one of them out"
    elif condition.parts and not missing:
        yield from _member_problems(rule, condition, by_name)


def _reaches(rule: Rule, name: str, by_name: Mapping[str, Rule]) -> bool:
    seen: set[str] = set()
    waiting = [rule]
    while waiting:
        condition = waiting.pop().condition
        for part in condition.parts if isinstance(condition, Combination) else ():
            if part.rule == name:
                return True
            if part.rule in by_name and part.rule not in seen:
                seen.add(part.rule)
                waiting.append(by_name[part.rule])
    return False


def universal(rule: Rule) -> bool:
    """Return whether an event of the rule concerns every agent."""
    return rule.scope == GROUP or isinstance(rule.condition, Always)


def _member_problems(rule: Rule, condition: Combination, by_name: Mapping[str, Rule]) -> Iterator[Problem]:
    """The problem of a combination whose parts do not say for which agents (or pairs) it could hold."""
    if rule.scope == GROUP or (rule.agents and condition.mode != SEQUENCE):
        return
    parts = [(by_name[part.rule], part.negated) for part in condition.parts]
    naming = [other for other, negated in parts if not negated and not universal(other)]
    if condition.mode == SEQUENCE:
        last = parts[-1][0]
        if universal(last) or (rule.scope == PAIR and last.scope != PAIR):
            yield SEQUENCE, f"the last rule must have events of scope {rule.scope}, as this one; or set scope: group"
    elif (condition.mode == ALL and not naming) or (condition.mode == ANY and len(naming) < len(parts)):
        yield "agents", "is missing; the parts do not say for which agents this holds. List them, or set scope: group"
    elif rule.scope == PAIR and not any(other.scope == PAIR for other in naming):
        yield "scope", "pair needs agents, or a part of scope pair that is not negated"
