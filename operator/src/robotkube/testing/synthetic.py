"""A large made-up fleet: many chart versions, nodes and demands that main meets, the same for the same arguments.

For measurements and for properties of composition. A fifth of the machines are edge machines, a tenth clouds, the rest
vehicles; half of the applications record the data of two vehicles in a cloud, the others perceive on an edge machine
with two services that a ros link joins. What is on main answers those demands.
"""

from __future__ import annotations

import json
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robotkube.delivery.deployment.core.releases import Release, Source, Tree, read_release, write_release
from robotkube.delivery.manager.core.composition.composer import Demand, Inputs, Memo, Validate, compose
from robotkube.delivery.manager.core.placement.capacity import Resources
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet
from robotkube.delivery.tasks.core.task_description import TaskDescription
from robotkube.foundation.documents.core.patterns import ROS_TOPIC, ROS_TYPE, TRACE, anchored
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.catalogue import Catalogue, read_catalogue

API = "registry.robotkube.io/v1alpha1"
PLATFORMS = ("linux/amd64", "linux/arm64")
CHARTS_URL = "oci://forge.example/verified"
PLAN = "20260101-000000-000000"
CREATED = "2026-11-21T10:00:00Z"
NODE_ROOM = Resources(4000, 8 * 2**30)

Schemas = Mapping[tuple[str, str], Mapping[str, Any]]

_TOPIC = {
    "type": "object",
    "additionalProperties": False,
    "required": ["name", "type"],
    "properties": {
        "name": {"type": "string", "pattern": anchored(ROS_TOPIC)},
        "type": {"type": "string", "pattern": anchored(ROS_TYPE)},
        "channel": {"enum": ["telemetry", "bulk"]},
        "reliability": {"enum": ["reliable", "best_effort"]},
        "durability": {"enum": ["volatile", "transient_local"]},
        "depth": {"type": "integer", "minimum": 1, "maximum": 100000},
        "buffer": {"type": "object", "additionalProperties": {"type": "integer"}},
    },
}
_TOPICS = {"type": "array", "items": {"$ref": "#/$defs/topic"}}
_SCHEMA = {
    "$schema": "http://json-schema.org/draft-07/schema#",
    "type": "object",
    "additionalProperties": False,
    "required": ["placement"],
    "properties": {
        "bridge": {"type": "object", "additionalProperties": False, "properties": {"out": _TOPICS, "in": _TOPICS}},
        "detector": {
            "type": "object",
            "additionalProperties": False,
            "properties": {
                "topics": _TOPICS,
                "peer": {"type": "string"},
                "trace": {"type": "string", "pattern": anchored(TRACE)},
                "rules": {"type": "array", "items": {"type": "object", "additionalProperties": True}},
            },
        },
        "placement": {
            "type": "object",
            "additionalProperties": False,
            "required": ["agent"],
            "properties": {"agent": {"type": "string"}, "node": {"type": "string"}, "movable": {"type": "boolean"}},
        },
        "global": {"type": "object", "additionalProperties": False, "properties": {"plan": {"type": "string"}}},
    },
    "$defs": {"topic": _TOPIC},
}
_QOS = {"reliability": "reliable", "durability": "volatile", "depth": 10}


@dataclass(frozen=True)
class Synthetic:
    """The made-up fleet; `tasks` are those that main meets by key, `tree` is main."""

    catalogue: Catalogue
    schemas: Schemas
    agents: tuple[Agent, ...]
    nodes: tuple[NodeState, ...]
    tasks: Mapping[str, TaskDescription]
    tree: Tree

    def schema(self, chart: str, version: str) -> Mapping[str, Any] | None:
        """The values schema of a chart version."""
        return self.schemas.get((chart, version))

    def inputs(self, render: Render, validate: Validate, present: Mapping[str, Release] | None = None) -> Inputs:
        """What composition depends on; `present` in place of main's releases."""
        machines = fleet(self.agents, self.nodes)
        releases = self.tree.releases if present is None else present
        return Inputs(self.catalogue, machines, releases, render, validate, schema=self.schema)

    def new_task(self, number: int) -> TaskDescription:
        """A task that main does not answer yet; another one for each number."""
        vehicles = [agent.name for agent in self.agents if agent.role == "vehicle"]
        return _task(len(self.tasks) + number, "new", vehicles, len(self.catalogue.applications) - 1)


def synthetic(
    render: Render,
    validate: Validate,
    charts: int = 50,
    versions: int = 10,
    nodes: int = 1000,
    task_count: int = 200,
    seed: int = 1,
) -> Synthetic:
    """A made-up fleet of these sizes."""
    chance = random.Random(seed)  # noqa: S311 - the same numbers every time are the point
    catalogue, schemas = _catalogue(charts, versions)
    agents, machines = _machines(nodes, chance)
    vehicles = [agent.name for agent in agents if agent.role == "vehicle"]
    tasks = [_task(number, "standing", vehicles, len(catalogue.applications) - 1) for number in range(task_count)]
    empty = Synthetic(catalogue, schemas, agents, machines, {}, Tree({}, {}))
    desired = compose(demands(tasks), empty.inputs(render, validate), Memo())
    releases = [replace(release, plan=PLAN) for release in desired.releases.values()]
    known = {release.path: read_release(write_release(release), release.path) for release in releases}
    sources = [Source(r.namespace, r.chart, r.digest, f"{CHARTS_URL}/{r.chart}") for r in releases]
    tree = Tree(known, {source.path: source for source in sources})
    return replace(empty, tasks={task.key: task for task in tasks}, tree=tree)


def demands(tasks: Sequence[TaskDescription]) -> list[Demand]:
    """The demands of tasks, in their order."""
    return [Demand(task.key, task.application, task.parameters, task=task) for task in tasks]


def _machines(count: int, chance: random.Random) -> tuple[tuple[Agent, ...], tuple[NodeState, ...]]:
    agents: list[Agent] = []
    nodes: list[NodeState] = []
    for number in range(count):
        role = "cloud" if number % 10 == 0 else "edge" if number % 5 == 1 else "vehicle"
        name = f"{role}-{number:04d}"
        capabilities = frozenset(["recording"] if role == "cloud" else ["gpu"] if chance.random() < 0.5 else [])
        platform = PLATFORMS[role == "vehicle"]
        agents.append(Agent(name, role, name))
        nodes.append(NodeState(name, name, role, capabilities, True, allocatable=NODE_ROOM, platform=platform))
    return tuple(agents), tuple(nodes)


def _catalogue(charts: int, versions: int) -> tuple[Catalogue, Schemas]:
    names = ["mqtt-bridge", *(f"service-{number:02d}" for number in range(charts - 1))]
    files = {"policies/release.yaml": "assurance: none\n", "applications/bridge.yaml": _bridge()}
    schemas: dict[tuple[str, str], Mapping[str, Any]] = {}
    for index, name in enumerate(names):
        for number in range(versions):
            version = f"0.{number + 1}.0"
            files[f"charts/{name}/{version}.yaml"] = _chart(name, version, index * versions + number)
            schemas[name, version] = {**_SCHEMA, "title": f"{name} {version}"}
    for index in range(max(charts - 1, 2) // 2):
        files |= {f"applications/{name}.yaml": text for name, text in (_recording(index), _perception(index, charts))}
    return read_catalogue(files), schemas


def _document(kind: str, name: str, spec: Mapping[str, Any], **more: Any) -> str:
    return json.dumps({"apiVersion": API, "kind": kind, "metadata": {"name": name}, "spec": spec, **more})


def _chart(name: str, version: str, number: int) -> str:
    spec = {
        "version": version,
        "description": "d",
        "channel": "stable",
        "platforms": list(PLATFORMS),
        "images": [],
        "provides": [f"does/{name}"],
        "resources": {"cpu": "30m", "memory": "64Mi"},
        "guarantees": [{"name": "delay", "atMost": 100 + number % 7, "unit": "ms"}],
    }
    return _document("ChartVersion", name, spec, status={"state": "verified", "digest": f"sha256:{number:064x}"})


def _application(name: str, word: str, parameters: Mapping[str, Any], services: Any, links: Any) -> tuple[str, str]:
    schema = {"type": "object", "additionalProperties": False, "required": list(parameters), "properties": parameters}
    spec = {"description": "d", "provides": [word], "parameters": schema, "services": services, "links": links}
    return name, _document("Application", name, spec)


def _bridge() -> str:
    values = {"bridge": {"out": "{{ topics.out }}", "in": "{{ topics['in'] }}"}}
    chart = {"name": "mqtt-bridge", "version": ">=0.1.0"}
    service = {"name": "bridge", "release": "mqtt-bridge", "chart": chart, "placement": {"agent": "{{ agent }}"}}
    return _application("bridge", "link/mqtt", {}, [{**service, "values": values}], [])[1]


def _topics(agent: str, names: Sequence[str]) -> list[dict[str, Any]]:
    return [{"name": f"/vehicles/{agent}/{n}", "type": "sensor_msgs/msg/PointCloud2", **_QOS} for n in names]


def _recording(index: int) -> tuple[str, str]:
    name = f"recording-{index:02d}"
    loop = {"vehicle": "{{ parameters.vehicles }}"}
    topics = _topics("{{ vehicle | ros }}", ["pose", "cloud", "transform"])
    buffered = [{**topic, "buffer": {"seconds": 10, "bytes": 1000000}} for topic in topics]
    service = {
        "name": "recorder",
        "release": f"r{index:02d}-{{{{ parameters.vehicles | join('-') }}}}",
        "chart": {"name": f"service-{index:02d}", "version": ">=0.1.0"},
        "placement": {"role": "cloud", "capabilities": ["recording"]},
        "values": {"detector": {"topics": [{"forEach": loop, "each": buffered}], "trace": "{{ task.trace }}"}},
    }
    carried = [{**topic, "channel": "telemetry"} for topic in topics]
    ends = {"from": {"agent": "{{ vehicle }}"}, "to": {"service": "recorder"}}
    link = {"kind": "mqtt", "forEach": loop, **ends, "topics": carried}
    parameters = {"vehicles": {"type": "array", "items": {"type": "string"}, "minItems": 1}}
    return _application(name, "recording/cloud", parameters, [service], [link])


def _perception(index: int, charts: int) -> tuple[str, str]:
    name = f"perception-{index:02d}"
    word = f"does/service-{charts - 2 - index:02d}"
    detect = {
        "name": "detection",
        "release": f"d{index:02d}-{{{{ parameters.vehicle }}}}",
        "chart": {"provides": word, "requirements": [{"guarantee": "delay", "atMost": 1, "unit": "s"}]},
        "placement": {"role": "edge", "capabilities": ["gpu"]},
        "values": {"detector": {"topics": _topics("{{ parameters.vehicle | ros }}", ["cloud"])}},
    }
    follow = {
        **detect,
        "name": "tracking",
        "release": f"t{index:02d}-{{{{ parameters.vehicle }}}}",
        "values": {"detector": {"peer": "{{ placement.detection }}", "trace": "{{ task.trace }}"}},
    }
    carried = [{**topic, "channel": "bulk"} for topic in _topics("{{ parameters.vehicle | ros }}", ["cloud"])]
    links = [
        {"kind": "ros", "from": {"service": "detection"}, "to": {"service": "tracking"}},
        {
            "kind": "mqtt",
            "from": {"agent": "{{ parameters.vehicle }}"},
            "to": {"service": "detection"},
            "topics": carried,
        },
    ]
    return _application(name, "perception/edge", {"vehicle": {"type": "string"}}, [detect, follow], links)


def _task(number: int, word: str, vehicles: Sequence[str], applications: int) -> TaskDescription:
    pairs = applications // 2
    index = (number // 2) % pairs
    recording = number % 2 == 0
    first, second = vehicles[2 * number % len(vehicles)], vehicles[(2 * number + 1) % len(vehicles)]
    return TaskDescription(
        namespace="cloud-0000",
        name=f"{word}-{number:05d}",
        generation=1,
        created=CREATED,
        requester="cloud-0000/event-detector",
        rule="proximity",
        event=f"event-{number:05d}",
        trace=f"{number:032x}",
        reason=f"{first}, {second} within 400 m",
        application=f"{'recording' if recording else 'perception'}-{index:02d}",
        parameters={"vehicles": [first, second]} if recording else {"vehicle": first},
    )
