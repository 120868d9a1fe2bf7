"""Index of the inputs of one composition: what can be looked up in catalogue, fleet and main while demands are met."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.inputs import Demand, Inputs
from robotkube.delivery.manager.core.composition.selection import Chosen, Selector
from robotkube.delivery.manager.core.placement.capacity import NOTHING, Occupancy, Resources, read_resources
from robotkube.delivery.manager.core.placement.criteria import AgentCriteria
from robotkube.delivery.manager.core.placement.link_needs import LinkNeed, forbidden
from robotkube.delivery.manager.core.placement.placement import Fleet, Group, NodeState
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.applications import Service
from robotkube.registry.catalogue.core.catalogue import Catalogue, Pin

Lookup = tuple[Any, ...]
"""What an expansion looked up in the fleet: ("agent", name), ("end", name), ("heard", topic, listener), ("role", role),
("agents", role, capabilities), ("platforms", agent, role)."""

Releases = Mapping[str, Release]
"""Releases by path."""

_Made = tuple[str, str]
"""The task that a release answers, and its name; the empty task stands for any."""

_NOWHERE: frozenset[str] = frozenset()
_NO_RELEASES: Releases = {}


class Index:
    """The inputs with what can be looked up in them. `fleet` has homes, `occupied` what releases of others reserve."""

    def __init__(
        self, inputs: Inputs, fleet: Fleet, selector: Selector, occupied: Occupancy, before: Index | None = None
    ) -> None:
        """`before` looked things up in the same fleet: what it knows of releases that are still on main is kept."""
        self.render: Render = inputs.render
        self.pins: Mapping[str, Pin] = inputs.pins
        self.fleet = fleet
        self.selector = selector
        self.occupied = occupied
        self.present: Mapping[str, Release] = dict(inputs.present)
        self.others: Mapping[str, Release] = dict(inputs.others)
        self._bridges: dict[str, tuple[Service, Chosen]] = {}
        self._bridge_needs: dict[str, Resources] = {}
        self._forbidden: dict[tuple[AgentCriteria, tuple[LinkNeed, ...]], Mapping[str, str]] = {}
        self._places: dict[_Made, frozenset[str]] = {}
        if before is None:
            self._releases = _by_task_and_name({}, {}, self.present, self.present)
        else:
            paths = different(before.present, self.present)
            self._releases = _by_task_and_name(before._releases, before.present, self.present, paths)
            kept = before._places.items()
            self._places = {m: at for m, at in kept if before._releases.get(m) is self._releases.get(m, _NO_RELEASES)}

    def answers(self, inputs: Inputs, fleet: Fleet, selector: Selector, occupied: Occupancy) -> bool:
        """Return whether it answers everything as an index of these would."""
        return (
            self.fleet is fleet
            and self.selector is selector
            and self.present == inputs.present
            and self.occupied is occupied
            and self.others == inputs.others
            and self.pins == inputs.pins
            and self.render == inputs.render
        )

    def kept(self, demand: Demand, name: Any) -> frozenset[str]:
        """Places on which this demand's release of that name runs already."""
        if not isinstance(name, str):
            return _NOWHERE
        made = (demand.key if demand.task else "", name)
        places = self._places.get(made)
        if places is None:
            releases = self._releases.get(made, _NO_RELEASES).values()
            places = frozenset().union(*(places_of(release, self.fleet) for release in releases))
            self._places[made] = places
        return places

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

    def bridge_need(self, kind: str) -> Resources:
        """The resources that a bridge of links of a kind asks for."""
        if kind not in self._bridge_needs:
            self._bridge_needs[kind] = read_resources(self.bridge(kind)[1][0].resources)
        return self._bridge_needs[kind]

    def forbidden(self, group: Group) -> Mapping[str, str]:
        """Candidates for a group on which the broker would refuse one of its links, with why."""
        needs = tuple(need for request in group.requests for need in request.links)
        if not needs or group.wanted.named:
            return {}
        key = (group.wanted, needs)
        if key not in self._forbidden:
            candidates = self.fleet.candidates(group.wanted)
            able = [a for a in candidates.agents if a.place in candidates.stay or a.place in candidates.lost]
            self._forbidden[key] = forbidden(needs, able)
        return self._forbidden[key]

    def runs(self, place: str, chart: str) -> bool:
        """Return whether a release of that chart is on the place already."""
        return (place, chart) in self._charts

    @cached_property
    def _charts(self) -> Collection[tuple[str, str]]:
        return {(place, r.chart) for r in self.present.values() for place in places_of(r, self.fleet)}

    def platforms(self, agent: str, role: str = "") -> frozenset[str]:
        """Platforms of the nodes of an agent, else of all agents of the role; none when one of them is not known."""
        names = [agent] if agent else [one.name for one in self.fleet.of_role.get(role, ())]
        platforms = {node.platform for name in names for node in self.fleet.nodes.get(name, ())}
        return frozenset() if "" in platforms else frozenset(platforms)


def different(first: Releases, second: Releases) -> list[str]:
    """The paths of releases that are not the same object on both sides."""
    gone = [path for path in first if path not in second]
    return gone + [path for path, release in second.items() if first.get(path) is not release]


def _by_task_and_name(
    known: Mapping[_Made, Releases], before: Releases, now: Releases, paths: Collection[str]
) -> Mapping[_Made, Releases]:
    """Releases by task and name: as they are `known` but for those at `paths`, which were as `before` and are `now`."""
    changed: dict[_Made, dict[str, Release]] = {}
    for made, path, _ in _made(before, paths):
        changed.setdefault(made, dict(known[made])).pop(path)
    for made, path, release in _made(now, paths):
        if made not in changed:
            changed[made] = dict(known.get(made, _NO_RELEASES))
        changed[made][path] = release
    gone = [made for made, releases in changed.items() if not releases]
    every: dict[_Made, Releases] = {**known, **changed}
    for made in gone:
        del every[made]
    return every


def _made(releases: Releases, paths: Iterable[str]) -> Iterator[tuple[_Made, str, Release]]:
    """Every task and name of the releases at `paths`."""
    for path in paths:
        if (release := releases.get(path)) is not None:
            for task in {"", *(cause.task for cause in release.causes)}:
                yield (task, release.name), path, release


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
