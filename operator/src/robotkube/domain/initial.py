"""The initial configuration: what the catalogue gives to agents of a role, plus and minus what people decided."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.domain.catalogue import Catalogue
from robotkube.domain.composition import Demand
from robotkube.domain.documents import Reader
from robotkube.domain.placement import Agent, Fleet
from robotkube.domain.releases import NAME
from robotkube.domain.texts import read_mapping

PATH = "policies/initial.yaml"


@dataclass(frozen=True)
class Addition:
    """An application for every agent of a role, or for named agents."""

    application: str
    role: str = ""
    agents: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Removal:
    """An application that named agents do not get."""

    application: str
    agents: tuple[str, ...]


@dataclass(frozen=True)
class InitialPolicy:
    """policies/initial.yaml."""

    add: tuple[Addition, ...] = ()
    remove: tuple[Removal, ...] = ()


def read_initial_policy(text: str, path: str = PATH) -> InitialPolicy:
    """`add: [{application, forRole | agents, parameters}]`, `remove: [{application, agents}]`; both may be missing."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", [], ["add", "remove"])
    add = [_addition(reader, item, f"add[{i}]") for i, item in enumerate(reader.sequence(document.get("add"), "add"))]
    remove = [
        _removal(reader, item, f"remove[{i}]")
        for i, item in enumerate(reader.sequence(document.get("remove"), "remove"))
    ]
    reader.finish()
    return InitialPolicy(tuple(add), tuple(remove))


def _addition(reader: Reader, item: Any, path: str) -> Addition:
    found = reader.mapping(item, path, ["application"], ["forRole", "agents", "parameters"])
    if ("forRole" in found) == ("agents" in found):
        reader.problems.append(f"{path}: needs either `forRole` or `agents`")
    parameters = found.get("parameters", {})
    if not isinstance(parameters, Mapping):
        reader.problems.append(f"{path}.parameters: must be a mapping")
        parameters = {}
    return Addition(
        reader.word(found.get("application"), f"{path}.application", NAME),
        reader.word(found.get("forRole"), f"{path}.forRole", NAME, default=""),
        _agents(reader, found, path),
        parameters,
    )


def _removal(reader: Reader, item: Any, path: str) -> Removal:
    found = reader.mapping(item, path, ["application", "agents"])
    return Removal(reader.word(found.get("application"), f"{path}.application", NAME), _agents(reader, found, path))


def _agents(reader: Reader, found: Mapping[str, Any], path: str) -> tuple[str, ...]:
    names = reader.sequence(found.get("agents"), f"{path}.agents")
    return tuple(reader.text(name, f"{path}.agents", NAME) for name in names)


def initial_demands(catalogue: Catalogue, policy: InitialPolicy, fleet: Fleet) -> list[Demand]:
    """One demand per (application, agent); an agent counts when it is declared and has a node. An addition replaces the
    catalogue's own instance of the same application on the same agent, so that people can set its parameters."""
    wanted: dict[tuple[str, str], Mapping[str, Any]] = {}
    for application in catalogue.applications.values():
        for agent in fleet.present(application.initial_for) if application.initial_for else ():
            wanted[application.name, agent.name] = {}
    for addition in policy.add:
        for agent in _chosen(addition, fleet):
            wanted[addition.application, agent.name] = addition.parameters
    removed = {(removal.application, agent) for removal in policy.remove for agent in removal.agents}
    return [
        Demand(f"initial/{application}/{agent}", application, parameters, agent=agent)
        for (application, agent), parameters in sorted(wanted.items(), key=lambda item: item[0])
        if (application, agent) not in removed
    ]


def _chosen(addition: Addition, fleet: Fleet) -> Sequence[Agent]:
    if addition.role:
        return fleet.present(addition.role)
    return [fleet.agents[name] for name in addition.agents if name in fleet.agents and fleet.nodes.get(name)]
