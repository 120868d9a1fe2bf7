"""Rule documents: what is refused, in which words, and that the schema agrees; random documents harm nothing."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator
from typing import Any

import jsonschema
import pytest

from robotkube.errors import DocumentError
from robotkube.robots.rules.core.specification.json_schema import KINDS, PROPERTIES, rules_schema
from robotkube.robots.rules.core.specification.specifications import Proximity, Threshold
from tests.stages.detector.rules import NUMBERS, POSES, RuleStage, problems_of, read
from tests.stages.examples import EXAMPLES

ENOUGH = max(EXAMPLES, 40)  # of fewer all are refused
CASES = [ENOUGH, pytest.param(20_000, marks=pytest.mark.thorough)]
SQUARE = [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]
SCHEMA = jsonschema.Draft7Validator(rules_schema())

GOOD: list[dict[str, Any]] = [
    {"name": "near", "kind": "proximity", "topic": POSES, "start_distance_m": 8, "stop_distance_m": 11},
    {"name": "few", "kind": "proximity", "topic": POSES, "start_distance_m": 8, "stop_distance_m": 11,
     "agents": ["vehicle-00", "vehicle-01"], "scope": "group", "at_least": 1, "stale_seconds": 2,
     "position": "pose.position"},
    {"name": "yard", "kind": "geofence", "topic": POSES, "area": {"type": "Polygon", "coordinates": [SQUARE]}},
    {"name": "yards", "kind": "geofence", "topic": POSES, "when": "outside", "margin": 2.5, "x": "pose.position.y",
     "area": {"type": "MultiPolygon", "coordinates": [[SQUARE], [[[20, 0], [30, 0], [30, 5]]]]}},
    {"name": "high", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_above": 5, "stop_below": 3,
     "sustained_seconds": 1, "minimum_interval_seconds": 5, "cooldown_seconds": 2, "every_seconds": 0.1,
     "expire_seconds": 30, "silent": True},
    {"name": "low", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_below": 3, "stop_above": 5},
    {"name": "slow", "kind": "rate", "topic": NUMBERS, "start_below_hz": 8, "stop_above_hz": 9, "window_seconds": 3},
    {"name": "lost", "kind": "absence", "topic": "/words", "seconds": 2, "agents": ["cloud-0"]},
    {"name": "both", "kind": "combination", "all": ["near", {"not": "high"}], "scope": "pair"},
    {"name": "calm", "kind": "combination", "not": "high", "agents": ["vehicle-00"]},
    {"name": "story", "kind": "combination", "sequence": ["low", "high"], "within_seconds": 10},
    {"name": "formula", "kind": "cel", "topic": NUMBERS, "fields": {"v": "data"}, "expression": "v > 2.0",
     "until": "v < 1.0", "budget_seconds": 0.5},
    {"name": "own", "kind": "python", "plugin": "closing", "topics": [POSES], "settings": {"a": [1]}, "scope": "pair"},
    {"name": "ever", "kind": "always"},
]  # fmt: skip


def changed(name: str, /, **keys: Any) -> dict[str, Any]:
    """A good rule with other keys; None takes one away."""
    rule = {**next(rule for rule in GOOD if rule["name"] == name), **keys}
    return {key: value for key, value in rule.items() if value is not None}


def test_all_kinds_can_be_read_together() -> None:
    rules = read(*GOOD)
    assert [rule.name for rule in rules] == [rule["name"] for rule in GOOD]
    assert {rule.kind for rule in rules} == set(KINDS)
    assert not list(SCHEMA.iter_errors(GOOD))
    assert read(rules_of_the_first_version()[0])[0].condition == Proximity(rules[0].topics[0], 400, 500)
    assert isinstance(read(rules_of_the_first_version()[1])[0].condition, Threshold)


def rules_of_the_first_version() -> list[dict[str, Any]]:
    """As charts of version 0.1.0 have them."""
    return [
        {"name": "lidar-proximity", "kind": "proximity", "agents": ["vehicle-00", "vehicle-01"], "topic": POSES,
         "start_distance_m": 400, "stop_distance_m": 500},
        {"name": "uncertain", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_above": 1,
         "stop_below": 1},
    ]  # fmt: skip


REFUSED = [
    (changed("near", kind="nearness"), "kind: must be one of proximity, geofence"),
    (changed("near", name=None), "name: is missing"),
    (changed("near", bad=1), "bad: unknown key; known are agents,"),
    (changed("near", topic="/pose"), "topic: must hold {agent}"),
    (changed("near", topic="pose"), "is not a full ROS topic name"),
    (changed("near", topic="/other/{agent}/pose"), "is not listed under topics; add it there"),
    (changed("near", stop_distance_m=7), "stop_distance_m: must not be less than start_distance_m"),
    (changed("near", agents=["a"]), "agents: must be a list of at least 2"),
    (changed("near", agents=["a", "B!"]), "agents: 'B!' is no agent's name"),
    (changed("near", position="pose.orient"), "position: pose.orient"),
    (changed("near", at_least=2), "at_least: unknown key"),
    (changed("both", scope="group"), "agents: is missing"),
    (changed("yard", area={"type": "Circle", "coordinates": []}), "area.type: must be one of Polygon, MultiPolygon"),
    (changed("yard", area={"type": "Polygon", "coordinates": [[[0, 0], [1, 1], [2, 2]]]}), "that enclose something"),
    (changed("yard", area={"type": "Polygon", "coordinates": [[[0, 0], [1, "1"], [2, 2]]]}), "[x, y] of two numbers"),
    (changed("yard", area={"type": "Polygon", "coordinates": [[[n % 2, n] for n in range(1001)]]}),
     "at most 1000 corners"),
    (changed("high", field="nothing"), "field: nothing:"),
    (changed("high", topic="/words"), "field: data of std_msgs/msg/String is no number"),
    (changed("high", stop_below=6), "stop_below: must not lie beyond start_above"),
    (changed("high", start_below=1), "start_below: unknown key"),
    (changed("high", start_above=None), "start_above: is missing; it must be a number"),
    (changed("high", start_above=None, stop_below=None, above=5),
     "start_above: is missing; it needs start_above and stop_below, or start_below and stop_above"),
    (changed("slow", start_below_hz=None), "start_below_hz: is missing; it must be a number"),
    (changed("near", start_distance_m="30 m"), "1e+07, not the text '30 m'; without unit and quotes, as 30 or 1.5"),
    (changed("few", at_least=2), "at_least: must not be more than 1: for so many it can hold, of 2 agents"),
    (changed("both", scope="group", agents=["a", "b"], at_least=2), "at_least: must not be more than 1"),
    (changed("high", scope="group", agents=["a", "b"], at_least=3), "at_least: must not be more than 2"),
    (changed("yard", area={"type": "Polygon", "coordinates": [[[0, 0], [2, 2], [2, 0], [0, 2]]]}),
     "area.coordinates: must hold rings that do not cross themselves; the edge from [0, 0] crosses that from [2, 0]"),
    (changed("high", sustained_seconds=-1), "sustained_seconds: must be a number from 0"),
    (changed("high", silent="yes"), "silent: must be true or false"),
    (changed("high", scope="pair"), "scope: must be one of agent, group"),
    (changed("slow", window_seconds=0.1), "window_seconds: must be long enough"),
    (changed("slow", start_below_hz=9000, stop_above_hz=9000), "window_seconds: must not let more than 10000"),
    (changed("slow", expire_seconds=3), "expire_seconds: unknown key"),
    (changed("both", all=["near", "nobody"]), "all: there is no rule nobody; name one of"),
    (changed("both", all=["near", "both"]), "all: the rule looks at itself"),
    (changed("both", all=["near"]), "all: must be a list of 2 to 32 names of rules"),
    (changed("both", any=["near", "high"]), "kind: a combination needs exactly one of the keys all, any, not"),
    (changed("both", all=["low", "high"]), "scope: pair needs agents, or a part of scope pair"),
    (changed("calm", agents=None), "agents: is missing; the parts do not say for which agents this holds"),
    (changed("story", sequence=["low", "ever"]), "sequence: the last rule must have events of scope agent"),
    (changed("story", sequence=["low", {"not": "high"}]), "sequence: must hold names of rules and nothing else"),
    (changed("story", within_seconds=None), "within_seconds: is missing"),
    (changed("formula", fields={}), "fields: must hold 1 to 32 names"),
    (changed("formula", fields={"a": "data"}), "fields.a: must be a name of letters, digits and _"),
    (changed("formula", fields={"v": "date"}), "fields: date:"),
    (changed("formula", expression=""), "expression: must be a text that is not empty"),
    (changed("formula", scope="pair"), "agents: is missing"),
    (changed("own", topics=["x"]), "topics: x is not a full ROS topic name"),
    (changed("own", plugin="other"), "plugin: no installed package offers the rule other; there are: closing"),
    (changed("ever", expire_seconds=5), "expire_seconds: unknown key"),
]  # fmt: skip


@pytest.mark.parametrize(("rule", "problem"), REFUSED)
def test_what_is_wrong_is_said_with_key_and_fix(rule: dict[str, Any], problem: str) -> None:
    documents = [rule if known["name"] == rule.get("name", "near") else known for known in GOOD]
    problems = problems_of(*documents, plugins=["closing"])
    assert [text for text in problems if problem in text], problems
    assert all(text.startswith("rules[") for text in problems)


def test_all_problems_are_named_at_once() -> None:
    problems = problems_of(
        changed("near", bad=1, start_distance_m="x"), {"kind": "what"}, changed("near", name="high"), 7
    )
    assert len(problems) >= 4
    assert {text.partition(".")[0].partition(":")[0] for text in problems} == {"rules[0]", "rules[1]", "rules[3]"}


@pytest.mark.parametrize("name", ["n" * 201, "two\nlines", "nothing\0"])
def test_a_name_is_short_and_on_one_line(name: str) -> None:
    (problem,) = problems_of(changed("near", name=name))
    assert problem == "rules[0].name: must be at most 200 characters on one line"
    assert not problems_of(changed("near", name="nähe, 200 m"))


def test_names_are_unique_and_processes_few() -> None:
    assert "is the name of another rule, too" in str(problems_of(GOOD[0], GOOD[0]))
    assert "at most 16 rules" in str(problems_of(*(changed("formula", name=f"f{n}") for n in range(17))))


def test_expressions_are_checked_where_the_caller_can() -> None:
    def check(texts: Any) -> list[str]:
        assert {names for _, names in texts} == {("v", "agent")}
        return ["" if ">" in text else f"no sense in {text}" for text, _ in texts]

    from robotkube.foundation.documents.core.reader import Reader
    from robotkube.robots.rules.core import read_rules
    from tests.stages.detector.rules import TOPICS, layouts

    reader = Reader("rules")
    item = reader.keys_of(changed("formula"), "rules[0]")
    read_rules([item], TOPICS, layouts(), check=check)
    assert reader.problems == ["rules[0].until: no sense in v < 1.0"]


def accepted(documents: list[Any]) -> bool:
    return not problems_of(*documents)


VALUES: tuple[Any, ...] = (
    None, 0, -1, 1, 7.5, 1e9, 10**30, True, "", "near", "/words", POSES, NUMBERS, "group", "pair", "inside", [], {},
    [1],
    ["near", "low"], ["a", "b"], [{"not": "high"}, "near"], {"v": "data"}, {"a": 1}, [[0, 0]], [[[SQUARE]]], "data",
    {"type": "Polygon", "coordinates": [SQUARE]}, {"type": "Polygon", "coordinates": SQUARE}, "é", "x" * 3000,
)  # fmt: skip


def mistaken(chance: random.Random) -> list[Any]:
    """The good rules with a few random changes of keys and values."""
    documents: list[Any] = copy.deepcopy(GOOD)
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(len(documents))
        rule = documents[at]
        kind = chance.randrange(5)
        if kind == 0 or not isinstance(rule, dict):
            documents[at] = chance.choice(VALUES)
        elif kind == 1 and rule:
            del rule[chance.choice(sorted(rule))]
        elif kind == 2 and rule:
            rule[chance.choice(sorted(rule))] = copy.deepcopy(chance.choice(VALUES))
        else:
            rule[chance.choice(sorted(PROPERTIES))] = copy.deepcopy(chance.choice(VALUES))
    return documents


@pytest.mark.parametrize("cases", CASES)
def test_random_rule_files_are_read_or_refused_and_the_schema_refuses_nothing_else(cases: int) -> None:
    refused = 0
    for seed in range(cases):
        documents = mistaken(random.Random(seed))  # noqa: S311 - the same cases every time
        errors = list(SCHEMA.iter_errors(documents))
        problems = problems_of(*documents)
        refused += bool(problems)
        if errors:
            assert problems, (seed, [error.message for error in errors], documents)
        if not problems:
            RuleStage(*documents).tick(1) if not asks(documents) else None
    assert 0 < refused < cases


def asks(documents: list[Any]) -> bool:
    return any(isinstance(rule, dict) and rule.get("kind") in ("cel", "python") for rule in documents)


def structural() -> Iterator[Any]:
    """Refusals that need no knowledge beyond the rule itself, and are no comparison of two numbers."""
    spoken = ("unknown key", "is missing;", "must be a number", "must be one of", "true or false", "must be a name of")
    for rule, problem in REFUSED:
        if any(word in problem for word in spoken) and "the parts do not" not in problem:
            yield rule


@pytest.mark.parametrize("rule", structural())
def test_the_schema_refuses_what_needs_no_knowledge(rule: dict[str, Any]) -> None:
    assert list(SCHEMA.iter_errors([rule]))


def test_a_document_that_is_no_mapping() -> None:
    with pytest.raises(DocumentError, match=r"rules\[0\]: must be a mapping"):
        read([1])
