"""The demands that the initial configuration makes: one for each application and agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.delivery.deployment.core.policies.initial import Addition, InitialPolicy
from robotkube.delivery.manager.core.composition.composer import Demand
from robotkube.delivery.manager.core.placement.placement import Agent, Fleet
from robotkube.registry.catalogue.core.catalogue import Catalogue


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
