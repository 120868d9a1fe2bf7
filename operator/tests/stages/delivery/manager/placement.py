"""A small catalogue, fleet and tasks, to see where services go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from robotkube.delivery.manager.core.composition.composer import Composition, Demand, Inputs, Met, Refused
from robotkube.delivery.manager.core.placement.capacity import Resources
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet
from robotkube.delivery.tasks.core.task_description import TaskDescription
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.catalogue.core.catalogue import Catalogue, read_catalogue

RENDER = Jinja2Templates().render
API = "registry.robotkube.io/v1alpha1"
SECOND = 1_000_000_000
ROOM = Resources(1000, 2**30)
HALF = {"cpu": "500m", "memory": "256Mi"}
AGENTS = [Agent(f"roadside-{i}", "roadside", f"roadside-{i}") for i in range(3)] + [
    Agent("cloud-0", "cloud", "cloud-0")
]
NODES = [NodeState(a.name, a.name, a.role, frozenset({"gpu"}), True, allocatable=ROOM) for a in AGENTS]
ONE = {"name": "a", "release": "a-{{ task.name }}", "placement": {"role": "roadside"}}


def chart(name: str = "worker", version: str = "0.1.0", **spec: Any) -> tuple[str, str]:
    about = {"version": version, "description": "d", "channel": "stable", "platforms": ["linux/amd64"], "images": []}
    document = {
        "apiVersion": API,
        "kind": "ChartVersion",
        "metadata": {"name": name},
        "spec": {**about, "resources": HALF, **spec},
        "status": {"state": "staged", "digest": "sha256:" + "0" * 64},
    }
    return f"charts/{name}/{version}.yaml", write_mapping(document)


def application(
    *services: Mapping[str, Any], name: str = "app", links: Sequence[Any] = (), word: str = "x"
) -> tuple[str, str]:
    wanted = {"chart": {"name": "worker", "version": ">=0.1.0"}}
    spec = {
        "description": "d",
        "provides": [word],
        "parameters": {"type": "object", "properties": {"agents": {"type": "array"}}},
        "services": [{**wanted, **service} for service in services],
        "links": list(links),
    }
    return f"applications/{name}.yaml", write_mapping(
        {"apiVersion": API, "kind": "Application", "metadata": {"name": name}, "spec": spec}
    )


def catalogue(*files: tuple[str, str]) -> Catalogue:
    read = read_catalogue({"policies/release.yaml": "assurance: none\n", **dict([chart(), *files])})
    assert read.problems == ()
    return read


PLAIN = catalogue(application(ONE))


def task(name: str = "t", **changes: Any) -> TaskDescription:
    described = TaskDescription(
        "ops", name, 1, "2026-11-21T10:00:00Z", "ops", "rule", "e", "a" * 32, "why", "app", {"agents": [name]}
    )
    return replace(described, **changes)


def demand(described: TaskDescription, **changes: Any) -> Demand:
    return replace(Demand(described.key, described.application, described.parameters, task=described), **changes)


def inputs(offered: Catalogue = PLAIN, nodes: Sequence[NodeState] = NODES, now: int = 0, **more: Any) -> Inputs:
    known: Inputs = Inputs(offered, fleet(AGENTS, nodes, now * SECOND), {}, RENDER, validate)
    return replace(known, **more)


def places(desired: Composition) -> dict[str, str]:
    assert all(isinstance(o, Met) for o in desired.outcomes.values()), desired.outcomes
    return {release.name: release.namespace for release in desired.releases.values()}


def refusal(desired: Composition, key: str = "ops/t") -> Refused:
    outcome = desired.outcomes[key]
    assert isinstance(outcome, Refused), outcome
    return outcome


def choices(desired: Composition, key: str = "ops/t") -> tuple[str, ...]:
    outcome = desired.outcomes[key]
    assert isinstance(outcome, Met), outcome
    return outcome.choices


def several(count: int, **changes: Any) -> list[Demand]:
    return [demand(task(f"t{number}", **changes)) for number in range(count)]
