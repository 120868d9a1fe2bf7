"""Circles of links: found in an application's document, with samples of its parameters, before anybody asks for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import check_schema, validate, violations
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.catalogue.core.applications import read_application
from robotkube.registry.catalogue.core.sources import Tools
from robotkube.registry.catalogue.core.template_validation import application_problems

TEMPLATES = Jinja2Templates()
TOOLS = Tools(TEMPLATES.render, TEMPLATES.references, check_schema, validate, violations)
QUALITY = {"channel": "telemetry", "reliability": "reliable", "durability": "volatile", "depth": 1}
NAMED = {"type": "string", "pattern": "^[a-z]+-[0-9]+$"}
FLEET = {"type": "array", "items": NAMED, "minItems": 1}
PAIR = {"a": NAMED, "b": NAMED}
SHARED = "/state"
MEDIUM = {"medium": "mqtt"}
EVERY = {"vehicle": "{{ parameters.fleet }}"}
OTHERS = "parameters.fleet[0] if vehicle == parameters.fleet[-1] else parameters.fleet[-1]"


def link(source: Mapping[str, str], target: Mapping[str, str], topic: str = SHARED, **more: Any) -> dict[str, Any]:
    topics = [{"name": topic, "type": "std_msgs/msg/String", **QUALITY}]
    return {"kind": "mqtt", "from": dict(source), "to": dict(target), "topics": topics, **more}


def agent(template: str) -> dict[str, str]:
    return {"agent": f"{{{{ {template} }}}}"}


def service(name: str, place: str, **more: Any) -> dict[str, Any]:
    chart = {"name": "relay", "version": ">=0.1.0"}
    return {"name": name, "release": f"{name}-x", "chart": chart, "placement": agent(place), **more}


def problems(
    parameters: Mapping[str, Any], links: Sequence[Any], *services: Any, initial_for: str = ""
) -> list[tuple[str, str]]:
    spec = {
        "description": "d",
        "provides": ["x"],
        "parameters": {"type": "object", "properties": dict(parameters), "required": [*parameters]},
        "services": list(services),
        "links": list(links),
        **({"initialFor": initial_for} if initial_for else {}),
    }
    head = {"apiVersion": "registry.robotkube.io/v1alpha1", "kind": "Application", "metadata": {"name": "x"}}
    application = read_application(write_mapping({**head, "spec": spec}), "applications/x.yaml")
    return application_problems(application, {}, TOOLS)


A, B = {"service": "a"}, {"service": "b"}
SERVICES = (service("a", "parameters.a"), service("b", "parameters.b"))


@pytest.mark.parametrize(
    ("parameters", "links", "services", "initial_for", "key", "words"),
    [
        (PAIR, [link(A, B), link(B, A)], SERVICES, "", "spec.links[0]", "enters it again by spec.links[1]"),
        (PAIR, [link(agent("parameters.a"), agent("parameters.b"))], (), "", "spec.links[0]", "by spec.links[0]"),
        ({"a": NAMED}, [link(agent("parameters.a"), MEDIUM), link(MEDIUM, A)], SERVICES[:1], "", "spec.links[0]", ""),
        ({}, [link(agent("agent"), {"role": "vehicle"})], (), "vehicle", "spec.links[0]", "leaves vehicle-00"),
        ({}, [link({"role": "roadside"}, {"role": "roadside"})], (), "", "spec.links[0]", "leaves a roadside"),
        (
            {"fleet": FLEET},
            [link(agent("vehicle"), agent(OTHERS), forEach=EVERY)],
            (),
            "",
            "spec.links[0]",
            "each message would come back; give the way back a topic of its own",
        ),
    ],
    ids=["two-services", "a-second-demand", "by-the-medium", "two-initial-ones", "a-role", "a-list"],
)
def test_a_circle_is_named(parameters: Any, links: Any, services: Any, initial_for: str, key: str, words: str) -> None:
    named = [(place, text) for place, text in problems(parameters, links, *services, initial_for=initial_for)]
    assert [place for place, text in named if "topic /state leaves" in text and words in text] == [key], named


LOOPING = {"forEach": EVERY, "release": "x-{{ vehicle }}"}


@pytest.mark.parametrize(
    ("parameters", "links", "services"),
    [
        (PAIR, [link(A, B, "/{{ parameters.a | ros }}/x"), link(B, A, "/{{ parameters.b | ros }}/y")], SERVICES),
        (PAIR, [link(agent("parameters.a"), {"role": "cloud"})], ()),
        ({"a": NAMED}, [link(agent("parameters.a"), MEDIUM), link(MEDIUM, A, "/other")], SERVICES[:1]),
        (
            {"fleet": FLEET},
            [link(A, B, "/{{ vehicle | ros }}/x"), link(B, A, "/{{ vehicle | ros }}/y")],
            (service("a", "vehicle", **LOOPING), service("b", "vehicle[:-1] + '9'", **LOOPING)),
        ),
    ],
    ids=["named-after-the-sender", "one-way", "another-topic", "in-pairs"],
)
def test_what_is_no_circle_has_no_problem(parameters: Any, links: Any, services: Any) -> None:
    assert problems(parameters, links, *services) == []
