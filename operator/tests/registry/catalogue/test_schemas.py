"""registry/schemas/: every schema refuses exactly what its reader refuses, but for what a schema cannot say."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import pytest

from robotkube.errors import DocumentError
from robotkube.foundation.documents.adapters.json_schema import check_schema, validate
from robotkube.registry.catalogue.core.applications import LINK_KINDS, read_application
from robotkube.registry.catalogue.core.catalogue import read_release_policy
from robotkube.registry.catalogue.core.chart_versions import read_chart_version
from robotkube.registry.catalogue.core.guarantees import UNITS
from robotkube.registry.evidence.core.verification_policy import read_verification_policy
from tests.stages.paths import REGISTRY

API = "registry.robotkube.io/v1alpha1"
DIGEST = "sha256:" + "0" * 64
GONE = object()
VALUES = (GONE, None, True, 0, -1, 1.5, "", "X y", ">=1.0.0", [], ["x"], {}, {"x": ["y"]})

APPLICATION = {
    "apiVersion": API,
    "kind": "Application",
    "metadata": {"name": "app"},
    "spec": {
        "description": "d",
        "provides": ["a/b", "c"],
        "initialFor": "cloud",
        "parameters": {"type": "object"},
        "services": [
            {
                "name": "one",
                "release": "one",
                "forEach": {"v": "{{ parameters.vs }}"},
                "chart": {
                    "name": "c",
                    "version": ">=0.1.0 <1.0.0",
                    "requirements": [{"guarantee": "g", "atMost": 3, "unit": "ms", "verified": True}],
                },
                "placement": {"role": "cloud", "capabilities": ["gpu"]},
                "values": {"a": 1},
            },
            {"name": "two", "release": "two", "chart": {"provides": "a/b"}, "placement": {"agent": "{{ agent }}"}},
            {
                "name": "three",
                "release": "x",
                "chart": {"provides": "a", "version": ">1.0.0"},
                "placement": {"capabilities": ["a"]},
            },
        ],
        "links": [
            {
                "kind": "mqtt",
                "forEach": {"v": ["a"]},
                "from": {"agent": "x"},
                "to": {"role": "cloud"},
                "topics": [
                    {
                        "name": "/a",
                        "type": "std_msgs/msg/String",
                        "channel": "safety",
                        "reliability": "reliable",
                        "durability": "volatile",
                        "depth": 10,
                        "deadline_seconds": 0.5,
                    }
                ],
            },
            {"kind": "ros", "from": {"service": "one"}, "to": {"service": "two"}},
        ],
    },
}
CHART = {
    "apiVersion": API,
    "kind": "ChartVersion",
    "metadata": {"name": "c"},
    "spec": {
        "version": "0.2.0",
        "description": "d",
        "channel": "stable",
        "platforms": ["linux/amd64"],
        "images": ["ros"],
        "settings": "watched",
        "provides": ["a/b"],
        "replaces": "0.1.0",
        "skips": ["0.0.1"],
        "resources": {"cpu": "100m", "memory": "64Mi"},
        "success": {
            "noEventOf": ["lidar-proximity", "r:1"],
            "probesOf": ["app"],
            "rates": [{"topic": "/x", "atLeastHz": 1.5}],
            "seconds": 60,
        },
        "guarantees": [{"name": "g", "atLeast": 1.5, "unit": "Hz", "description": "when alone"}],
        "interfaces": [
            {
                "name": "i",
                "medium": "ros",
                "direction": "in",
                "forEach": {"t": "{{ values.ts }}"},
                "topic": "/x",
                "type": "std_msgs/msg/String",
                "qos": {"reliability": "reliable", "durability": "volatile"},
                "causes": "o",
            },
            {
                "name": "o",
                "medium": "mqtt",
                "direction": "out",
                "topic": "x",
                "type": "std_msgs/msg/String",
                "qos": {"qos": 1, "retain": False},
                "encoding": "text",
            },
            {"name": "d", "medium": "database", "direction": "out", "topic": "samples"},
        ],
        "suites": {
            "sets": [
                {
                    "name": "first",
                    "values": {"a": 1},
                    "prepare": {"image": "ros", "command": ["make"]},
                    "configMaps": {"m": {"k": "v"}},
                },
                {"name": "second", "values": {}},
            ]
        },
    },
    "status": {
        "state": "verified",
        "digest": DIGEST,
        "images": [f"host/ros@{DIGEST}"],
        "evidence": DIGEST,
        "policy": DIGEST,
    },
}
POLICY = {
    "apiVersion": API,
    "kind": "VerificationPolicy",
    "metadata": {"name": "default"},
    "spec": {
        "suites": [
            {"name": "static", "version": "1", "seconds": 60},
            {
                "name": "mine",
                "version": "2",
                "seconds": 10,
                "image": f"host/mine@{DIGEST}",
                "command": ["go"],
                "installs": True,
            },
        ]
    },
}
KINDS: dict[str, tuple[Any, Callable[[str], object]]] = {
    "application": (APPLICATION, lambda text: read_application(text, "applications/app.yaml")),
    "chart-version": (CHART, lambda text: read_chart_version(text, "charts/c/0.2.0.yaml")),
    "release-policy": (
        {"assurance": "none", "initialFor": "person"},
        lambda text: read_release_policy(text, "policies/release.yaml"),
    ),
    "verification-policy": (POLICY, lambda text: read_verification_policy(text, "policies/verification.yaml")),
}
BEYOND_SCHEMAS = (
    "path: ",  # the file's name
    "is not among spec.services",
    "is not among spec.images",
    "is no interface of direction out",
    "is this version itself",
    "status: missing",  # which only the catalogue repository needs
    "status.state: ",
    "status.digest: missing",
)


@cache
def schema(name: str) -> dict[str, Any]:
    """The same object each time: what is made of a schema is kept by it."""
    return dict(json.loads((REGISTRY / "schemas" / f"{name}.json").read_text()))


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every place in a document, and a place beside each mapping's keys."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*path, key)
        yield from places(inner, (*path, key))
    if isinstance(value, dict):
        yield (*path, "surprise")


def changed(document: Any, path: tuple[Any, ...], value: Any) -> Any:
    copied = copy.deepcopy(document)
    place = copied
    for part in path[:-1]:
        place = place[part]
    if value is not GONE:
        place[path[-1]] = copy.deepcopy(value)
    elif path[-1] in place if isinstance(place, dict) else True:
        del place[path[-1]]
    return copied


def reader_problems(name: str, document: Any) -> tuple[str, ...]:
    try:
        KINDS[name][1](json.dumps(document))  # JSON is YAML
    except DocumentError as error:
        return error.problems
    return ()


@pytest.mark.parametrize("name", sorted(KINDS))
def test_the_examples_are_valid(name: str) -> None:
    assert check_schema(schema(name)) == []
    assert validate(schema(name), KINDS[name][0]) == []
    assert reader_problems(name, KINDS[name][0]) == ()


def test_every_schema_has_a_reader() -> None:
    assert {path.stem for path in (REGISTRY / "schemas").glob("*.json")} == set(KINDS)


@pytest.mark.parametrize("name", sorted(KINDS))
def test_schema_and_reader_refuse_the_same(name: str) -> None:
    example = KINDS[name][0]
    differences = []
    refusals = 0
    for path in places(example):
        for value in VALUES:
            document = changed(example, path, value)
            by_schema = validate(schema(name), document)
            by_reader = reader_problems(name, document)
            refusals += bool(by_reader)
            said = [problem for problem in by_reader if not any(text in problem for text in BEYOND_SCHEMAS)]
            if bool(by_schema) != bool(said) and not (by_schema and by_reader):
                differences.append((path, value, by_schema[:1], said[:1]))
    assert differences == [], "\n".join(map(str, differences))
    assert refusals > 10


def test_closed_lists_agree() -> None:
    application, chart = schema("application")["$defs"], schema("chart-version")["$defs"]
    assert application["unit"]["enum"] == chart["guarantee"]["properties"]["unit"]["enum"] == list(UNITS)
    kinds = [link["properties"]["kind"]["const"] for link in (application["mqttLink"], application["rosLink"])]
    assert sorted(kinds) == sorted(LINK_KINDS)
