"""Samples by which an application is tried: sets of its parameters, demands for it, and agents that could serve them.

Everything follows from the application's document, so that the same document is always tried alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import chain
from typing import Any

from robotkube.delivery.manager.core.composition.inputs import Demand
from robotkube.delivery.manager.core.placement.placement import Agent, Fleet, NodeState, fleet
from robotkube.delivery.tasks.core.task_description import TaskDescription
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.defaults import with_defaults
from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.schema_samples import Sampler
from robotkube.foundation.documents.core.value_templates import Render, expand_for_each
from robotkube.registry.catalogue.core.applications import Application, Link
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.charts.core.values_schemas import Validate

COMBINATIONS = 16  # sets of parameters that are drawn, besides those that vary one parameter each
AGENTS_MAX = 128
PER_ROLE = 3
BY_TASK, BY_AGENT = "task", "agent"
ROLES = ("vehicle", "cloud")  # what every inventory has
NAMESPACE = "cloud-00"
TRACE = "0" * 32
TIME = "2026-11-21T10:00:00Z"

_TOPIC = {
    "name": "/vehicles/vehicle_00/pose", "type": "geometry_msgs/msg/PoseStamped", "channel": "telemetry",
    "reliability": "reliable", "durability": "volatile", "depth": 10,
}  # fmt: skip
_CLOUD = {**_TOPIC, "name": "/vehicles/vehicle_00/cloud", "type": "sensor_msgs/msg/PointCloud2", "channel": "bulk"}

Parameters = Mapping[str, Any]


def sampled_parameters(application: Application, validate: Validate) -> Sequence[Parameters]:
    """Sets of parameters that the application's schema accepts: what is required, everything, each value of each
    parameter, and combinations that the document's digest draws. None when no guess was accepted."""
    sampler = Sampler(application.parameters, validate)
    samples: list[Parameters] = list(sampler.objects())
    for number in range(COMBINATIONS) if len(sampler.properties) > 1 else ():
        drawn = {
            name: values[_drawn(application.digest, number, name) % len(values)]
            for name, values in sampler.properties.items()
            if values
        }
        if drawn not in samples and not validate(application.parameters, drawn):
            samples.append(drawn)
    return samples


def _drawn(digest: str, number: int, name: str) -> int:
    return int(sha256(f"{digest} {number} {name}".encode()).hexdigest()[:8], 16)


def with_subject(catalogue: Catalogue, name: str) -> tuple[Catalogue, Application]:
    """The application that is asked for in a trial of `name`, and the catalogue that has it: itself, or, for one that
    only bridges links, one that links with two topics."""
    application = catalogue.applications[name]
    if not application.bridges:
        return catalogue, application
    links = tuple(
        Link(kind, {"agent": "{{ agent }}"}, {"role": ROLES[1]}, (_TOPIC, _CLOUD)) for kind in application.bridges
    )
    linking = Application(f"{name}-linked", "", (), {"type": "object"}, (), links, ROLES[0], application.digest)
    return replace(catalogue, applications={**catalogue.applications, linking.name: linking}), linking


def ways(application: Application) -> Sequence[str]:
    """How an application may be asked for: one that runs by itself for an agent; any other by a task, or for an agent
    that policies/initial.yaml names."""
    return (BY_AGENT,) if application.initial_for else (BY_TASK, BY_AGENT)


def demand(application: Application, parameters: Parameters, way: str) -> Demand:
    """The demand for an application in one of its ways."""
    if way == BY_AGENT:
        agent = f"{application.initial_for or ROLES[0]}-00"
        return Demand(f"initial/{application.name}/{agent}", application.name, parameters, agent=agent)
    task = TaskDescription(
        *(NAMESPACE, "sample", 1, TIME, f"{NAMESPACE}/event-detector", "rule-1", "event-1", TRACE, "a sample"),
        application.name,
        parameters,
        event_details={"time": TIME},
    )
    return Demand(task.key, application.name, parameters, task=task)


def inventory(application: Application, parameters: Parameters, render: Render) -> Fleet:
    """Agents of every role that the application names, and those that its templates and parameters name; each of them
    has every capability that it asks for."""
    ends = [end for link in application.links for end in (link.source, link.target)]
    asked = [service.placement.role for service in application.services] + [end.get("role", "") for end in ends]
    listed = application.agents.values()
    roles = dict.fromkeys([*ROLES, *asked, application.initial_for, *(wanted.role for wanted in listed)])
    roles.pop("", None)
    agents = [Agent(name, role, name) for role in roles for name in (f"{role}-{n:02d}" for n in range(PER_ROLE))]
    taken = {agent.name for agent in agents}
    names = dict.fromkeys([*_named(application, parameters, render), *_words(parameters)])
    others = [name for name in names if name not in taken and NAME.fullmatch(name)]
    agents += [Agent(name, ROLES[0], name) for name in others[:AGENTS_MAX]]
    of_services = [service.placement.capabilities for service in application.services]
    capabilities = frozenset(chain(*of_services, *(wanted.capabilities for wanted in listed)))
    nodes = [NodeState(agent.name, agent.name, agent.role, capabilities, True) for agent in agents]
    return fleet(agents, nodes)


def _named(application: Application, parameters: Parameters, render: Render) -> Iterator[str]:
    """Names that the templates for agents give; what needs a placement to be known is left out."""
    given = with_defaults(application.parameters, parameters)
    names = {
        "parameters": given,
        "placement": {},
        "agents": {name: [] for name in application.agents},
        "agent": f"{application.initial_for or ROLES[0]}-00",
    }
    texts = [(service.for_each, service.placement.agent) for service in application.services]
    texts += [(link.for_each, end.get("agent", "")) for link in application.links for end in (link.source, link.target)]
    for for_each, text in texts:
        try:
            yield from (str(render(text, scope)) for scope in expand_for_each(for_each, names, render) if text)
        except DocumentError:
            continue


def _words(value: Any) -> Iterator[str]:
    """Every text in a value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _words(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _words(inner)
