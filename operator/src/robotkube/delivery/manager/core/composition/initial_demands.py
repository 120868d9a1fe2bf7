"""The demands that no task makes: of the initial configuration one for each application and agent, of what other
scopes hear one for each topic."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robotkube.delivery.deployment.core.borders import speaker
from robotkube.delivery.deployment.core.policies.initial import Addition, InitialPolicy
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.composer import Demand
from robotkube.delivery.manager.core.placement.placement import Agent, Fleet
from robotkube.delivery.manager.core.placement.scopes import ScopedFleet
from robotkube.registry.catalogue.core.applications import TOPIC_KEYS, TOPIC_KEYS_OPTIONAL
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.robots.bridge.core.rights import OUT, may


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


def sent_to_others(others: Mapping[str, Release], fleet: Fleet) -> list[Demand]:
    """The topics of this scope's agents that bridges of `others` bring in by consent of both scopes: the agents are to
    send them, in the way in which they are brought in."""
    if not isinstance(fleet, ScopedFleet):
        return []
    wanted: dict[str, Demand] = {}
    for _, release in sorted(others.items()):
        for topic in _brought_in(release):
            agent = fleet.agents.get(speaker(topic["name"]))
            if agent is None or not may(agent, OUT, topic["name"]) or not fleet.nodes.get(agent.name):
                continue
            if not fleet.borders.missing(topic["name"], release.namespace):
                application = f"links-of-{fleet.borders.scopes[release.namespace]}"
                key = f"initial/{application}/{agent.name}{topic['name']}"
                wanted.setdefault(key, Demand(key, application, {}, agent=agent.name, sent=topic))
    return list(wanted.values())


def _brought_in(release: Release) -> Iterator[Mapping[str, Any]]:
    """The topics that a bridge brings in under the names under which they are said, as links write them."""
    bridge = release.values.get("bridge")
    items = bridge.get("in") if isinstance(bridge, Mapping) else None
    for item in items if isinstance(items, list) else ():
        if isinstance(item, Mapping) and all(isinstance(item.get(key), str | int) for key in TOPIC_KEYS):
            yield {key: item[key] for key in (*TOPIC_KEYS, *TOPIC_KEYS_OPTIONAL) if key in item}
