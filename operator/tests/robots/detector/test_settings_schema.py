"""The event detector's schema and its reader: what one refuses without knowing more, the other refuses, too."""

from __future__ import annotations

import json
from typing import Any

import jsonschema
import pytest
import yaml

from ci.reference import charts
from robotkube.errors import DocumentError
from robotkube.robots.detector.core.settings import read_detector_settings
from robotkube.robots.detector.core.settings_schema import detector_schema
from robotkube.robots.rules.core.specification.json_schema import Schema
from tests.stages.paths import CHART_PROFILES

SCHEMA: Schema = {"type": "object", "additionalProperties": False, "properties": detector_schema()}
VALIDATOR = jsonschema.Draft7Validator(SCHEMA)
TOPIC = {"name": "/a", "type": "std_msgs/msg/Float64"}
RULE = {"name": "a", "kind": "always"}
RECORDED = {"name": "/a", "storage": "segment"}
REACTIONS: dict[str, dict[str, Any]] = {
    "operator": {"application": "x"},
    "recording": {"recording": "r", "volume": "v", "topics": [RECORDED]},
    "webhook": {"url": "https://example.invalid/x"},
    "mqtt": {"topic": "events/a"},
    "python": {"plugin": "p"},
}
WRONG_TOPICS: list[dict[str, Any]] = [
    {"name": "a"},
    {"name": None},
    {"source": "dds"},
    {"reliability": "yes"},
    {"durability": 1},
    {"depth": 0},
    {"depth": 1.5},
    {"depth": 100_001},
    {"deadline_seconds": 0},
    {"liveliness": "no"},
    {"liveliness_seconds": -1},
    {"stale_seconds": 86_401},
    {"expire_seconds": 0.9},
    {"qos": 1},
    {"buffer": {"seconds": 0}},
    {"buffer": {"bytes": 0}},
    {"buffer": {"count": 1_000_001}},
    {"buffer": {"duplicates": True}},
    {"buffer": {"jump": "stop"}},
    {"buffer": {"age": 1}},
    {"buffer": []},
]
WRONG_REACTIONS: list[tuple[str, dict[str, Any]]] = [
    ("operator", {"lease_seconds": 4}),
    ("operator", {"parameters": []}),
    ("operator", {"secret": "x"}),
    ("operator", {"application": ""}),
    ("recording", {"recording": "A"}),
    ("recording", {"volume": "V/1"}),
    ("recording", {"topics": []}),
    ("recording", {"topics": [{"name": "/a"}]}),
    ("recording", {"topics": [{**RECORDED, "storage": "tape"}]}),
    ("recording", {"topics": [{**RECORDED, "before_seconds": -1}]}),
    ("recording", {"topics": [{**RECORDED, "after_seconds": 601}]}),
    ("recording", {"topics": [{**RECORDED, "x": 1}]}),
    ("recording", {"afterSeconds": 3}),
    ("recording", {"provenance": "x"}),
    ("webhook", {"url": "ftp://x"}),
    ("webhook", {"url": "https://me@x"}),
    ("webhook", {"secret": "a/b"}),
    ("webhook", {"timeout_seconds": 0}),
    ("webhook", {"retry_seconds": 86_401}),
    ("mqtt", {"topic": "a/#"}),
    ("mqtt", {"topic": "$SYS"}),
    ("mqtt", {"retained": "no"}),
    ("python", {"settings": 1}),
    ("python", {"plugin": 7}),
    ("mail", {}),
]


def document(**more: Any) -> dict[str, Any]:
    return {"topics": [TOPIC], "rules": [RULE], **more}


def reaction(kind: str, **more: Any) -> dict[str, Any]:
    return {"rule": "a", "kind": kind, **REACTIONS.get(kind, {}), **more}


def verdicts(settings: dict[str, Any]) -> tuple[bool, bool]:
    """Return whether the schema accepts it, and whether the reader does."""
    try:
        read_detector_settings({"name": "cloud-0/detector", **settings}, "config.yaml")
        read = True
    except DocumentError:
        read = False
    return VALIDATOR.is_valid(settings), read


@pytest.mark.parametrize("profile", ["event-detector", "earlier/event-detector"])
def test_whole_documents_are_accepted_by_both(profile: str) -> None:
    values = yaml.safe_load((CHART_PROFILES / f"{profile}.yaml").read_text(encoding="utf-8"))
    assert verdicts(values["detector"]) == (True, True)


@pytest.mark.parametrize("kind", REACTIONS)
def test_every_kind_of_reaction_is_accepted_by_both(kind: str) -> None:
    assert verdicts(document(reactions=[reaction(kind)])) == (True, True)


@pytest.mark.parametrize("kind", REACTIONS)
def test_what_a_reaction_needs_is_missed_by_both(kind: str) -> None:
    for key in REACTIONS[kind]:
        without = {name: value for name, value in reaction(kind).items() if name != key}
        assert verdicts(document(reactions=[without])) == (False, False), key


@pytest.mark.parametrize("wrong", WRONG_TOPICS, ids=str)
def test_a_wrong_topic_is_refused_by_both(wrong: dict[str, Any]) -> None:
    assert verdicts(document(topics=[{**TOPIC, **wrong}])) == (False, False)


@pytest.mark.parametrize(("kind", "wrong"), WRONG_REACTIONS, ids=str)
def test_a_wrong_reaction_is_refused_by_both(kind: str, wrong: dict[str, Any]) -> None:
    assert verdicts(document(reactions=[reaction(kind, **wrong)])) == (False, False)


@pytest.mark.parametrize(
    "wrong", [{"state": "off"}, {"buffer": {"bytes": 1}}, {"buffer": {"size": 1}}, {"task": "x"}, {"rule": []}], ids=str
)
def test_wrong_settings_of_the_process_are_refused_by_both(wrong: dict[str, Any]) -> None:
    assert verdicts(document(**wrong)) == (False, False)


def test_the_chart_has_the_schema_of_the_code() -> None:
    text = charts.SCHEMA.read_text(encoding="utf-8")
    assert json.loads(text) == json.loads(charts.schema_text(text)), "run: make reference"
