"""Index of the inputs of one composition: what can be looked up in catalogue, fleet and main while demands are met."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.inputs import Demand, Inputs
from robotkube.delivery.manager.core.composition.selection import Chosen, Selector
from robotkube.delivery.manager.core.placement.capacity import NOTHING, Occupancy, Resources, read_resources
from robotkube.delivery.manager.core.placement.link_needs import LinkNeed, forbidden
from robotkube.delivery.manager.core.placement.placement import AgentCriteria, Fleet, Group, NodeState
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.applications import Service
from robotkube.registry.catalogue.core.catalogue import Catalogue, Pin

Lookup = tuple[Any, ...]
"""What an expansion looked up in the fleet: ("agent", name), ("end", name), ("heard", topic, listener), ("role", role),
("agents", role, capabilities), ("platforms", agent, role)."""

_NOWHERE: frozenset[str] = frozenset()


class Index:
    """The inputs with what can be looked up in them. `fleet` has homes, `occupied` what releases of others reserve."""

    def __init__(self, inputs: Inputs, fleet: Fleet, selector: Selector, occupied: Occupancy) -> None:
        self.render: Render = inputs.render
        self.pins: Mapping[str, Pin] = inputs.pins
        self.fleet = fleet
        self.selector = selector
        self.occupied = occupied
        self.present: Mapping[str, Release] = dict(inputs.present)
        self.others: Mapping[str, Release] = dict(inputs.others)
        self._places: dict[tuple[str, str], frozenset[str]] = {}
        self._bridges: dict[str, tuple[Service, Chosen]] = {}
        self._forbidden: dict[tuple[AgentCriteria, tuple[LinkNeed, ...]], Mapping[str, str]] = {}

    def same(self, other: Index) -> bool:
        """Whether both answer everything alike."""
        return (
            self.fleet is other.fleet
            and self.selector is other.selector
            and self.present == other.present
            and self.occupied is other.occupied
            and self.others == other.others
            and self.pins == other.pins
            and self.render == other.render
        )

    def kept(self, demand: Demand, name: Any) -> frozenset[str]:
        """Places on which this demand's release of that name runs already."""
        if not isinstance(name, str):
            return _NOWHERE
        key = (demand.key if demand.task else "", name)
        places = self._places.get(key)
        if places is None:
            places = frozenset().union(*(places_of(release, self.fleet) for release in self._releases.get(key, ())))
            self._places[key] = places
        return places

    @cached_property
    def _releases(self) -> Mapping[tuple[str, str], Sequence[Release]]:
        """Releases by task and name; by name alone under the empty task."""
        releases: dict[tuple[str, str], list[Release]] = defaultdict(list)
        for release in self.present.values():
            releases["", release.name].append(release)
            for cause in release.causes:
                releases[cause.task, release.name].append(release)
        return releases

    def kept_application(self, demand: Demand) -> str:
        """The application that answers the demand's task on main; empty when none does."""
        return self._applications.get(demand.key, "")

    @cached_property
    def _applications(self) -> Mapping[str, str]:
        return {cause.task: cause.application for release in self.present.values() for cause in release.causes}

    def lookup(self, lookup: Lookup) -> Any:
        """The fleet's answer; RefusalError as the fleet raises it."""
        if lookup[0] == "agent":
            return self.fleet.agent(lookup[1])
        if lookup[0] == "end":
            return self.fleet.link_end(lookup[1])
        if lookup[0] == "heard":
            return self.fleet.check_heard(lookup[1], lookup[2])
        if lookup[0] == "role":
            return self.fleet.present(lookup[1])
        if lookup[0] == "agents":
            return self.able(lookup[1], lookup[2])
        return self.platforms(lookup[1], lookup[2])

    def able(self, role: str, capabilities: Sequence[str]) -> tuple[str, ...]:
        """The names of the agents of a role (of any, when it is empty) whose Nodes have all capabilities."""
        machines = [(agent.name, self.fleet.machines(agent)) for agent in self.fleet.present(role)]
        return tuple(
            name
            for name, nodes in machines
            if all(any(capability in node.capabilities for node in nodes) for capability in capabilities)
        )

    def bridge(self, kind: str) -> tuple[Service, Chosen]:
        """As Selector.bridge."""
        if kind not in self._bridges:
            self._bridges[kind] = self.selector.bridge(kind)
        return self._bridges[kind]

    def forbidden(self, group: Group) -> Mapping[str, str]:
        """Candidates for a group on which the broker would refuse one of its links, with why."""
        needs = tuple(need for request in group.requests for need in request.links if need.binds)
        if not needs or group.wanted.named:
            return {}
        key = (group.wanted, needs)
        if key not in self._forbidden:
            candidates = self.fleet.candidates(group.wanted)
            able = [a for a in candidates.agents if a.place in candidates.stay or a.place in candidates.lost]
            self._forbidden[key] = forbidden(needs, able)
        return self._forbidden[key]

    def runs(self, place: str, chart: str) -> bool:
        """Whether a release of that chart is on the place already."""
        return (place, chart) in self._charts

    @cached_property
    def _charts(self) -> Collection[tuple[str, str]]:
        return {(place, r.chart) for r in self.present.values() for place in places_of(r, self.fleet)}

    def platforms(self, agent: str, role: str = "") -> frozenset[str]:
        """Platforms of the nodes of an agent, else of all agents of the role; none when one of them is not known."""
        names = [agent] if agent else [one.name for one in self.fleet.of_role.get(role, ())]
        platforms = {node.platform for name in names for node in self.fleet.nodes.get(name, ())}
        return frozenset() if "" in platforms else frozenset(platforms)


def places_of(release: Release, fleet: Fleet) -> tuple[str, ...]:
    """The place of a release as its values say; else those of its namespace. Of several Nodes it is on the home when it
    names none that is there."""
    agent = fleet.agents.get(placed_on(release, "agent"))
    if agent is not None and agent.namespace == release.namespace:
        names: tuple[str, ...] = (agent.name,)
    else:
        names = fleet.by_namespace.get(release.namespace, ())
    if fleet.homes.keys().isdisjoint(names):
        return names
    node = placed_on(release, "node")
    agents = [fleet.agents[name] for name in names]
    return tuple(p.place if (p := replace(a, node=node)).place in fleet.at else fleet.home(a).place for a in agents)


def placed_on(release: Release, key: str) -> str:
    """`agent` or `node` of a release's placement; empty when its values name none."""
    placement = release.values.get("placement")
    name = placement.get(key) if isinstance(placement, Mapping) else None
    return name if isinstance(name, str) else ""


def housed(fleet: Fleet, present: Iterable[Release]) -> Fleet:
    """The fleet with a home for every agent whose Nodes count one by one: that has several, or releases that name the
    one it has left. Home is where the most releases are that are bound to it, unless that Node is lost; else the first
    that takes pods, the oldest before others."""
    named: dict[str, dict[str, int]] = {}
    for release in present:
        if node := placed_on(release, "node"):
            votes = named.setdefault(placed_on(release, "agent"), {})
            votes[node] = votes.get(node, 0) + (not release.values["placement"].get("movable"))
    homes = {}
    for name, nodes in fleet.nodes.items():
        if name not in fleet.agents or (len(nodes) == 1 and name not in named):
            continue
        votes = named.get(name, {})
        if len(nodes) > 1 or any(node.name in votes for node in nodes):
            homes[name] = _home(nodes, votes)
    return replace(fleet, homes=homes) if homes else fleet


def _home(nodes: Sequence[NodeState], votes: Mapping[str, int]) -> str:
    usable = [node for node in nodes if not node.lost] or nodes
    rank = {n.name: (-votes.get(n.name, 0), not n.ready or n.cordoned, n.created, n.name) for n in usable}
    return min(rank, key=lambda name: rank[name])


def occupied(others: Mapping[str, Release], fleet: Fleet, catalogue: Catalogue) -> Occupancy:
    """The capacity that releases of others reserve on their places."""
    occupancy = Occupancy()
    for release in others.values():
        for place in places_of(release, fleet)[:1]:
            occupancy.reserve(place, need_of(release, catalogue))
    return occupancy


def need_of(release: Release, catalogue: Catalogue) -> Resources:
    """The resources that a release asks for, by the catalogue's chart version; none when it is not known there."""
    version = catalogue.version(release.chart, release.version)
    return read_resources(version.resources) if version else NOTHING
