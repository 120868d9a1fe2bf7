"""The inputs of one composition with everything that can be looked up in them, kept for as long as they stay equal."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from robotkube.domain.capacities import NOTHING, Occupancy, Resources, read_resources
from robotkube.domain.catalogue import Catalogue, Pin
from robotkube.domain.loops import Render
from robotkube.domain.placement import Fleet, NodeState
from robotkube.domain.releases import Release
from robotkube.domain.selection import Selector
from robotkube.domain.worlds import Demand, World

Question = tuple[Any, ...]
"""What a draft asked the fleet: ("agent", name), ("role", role), ("platforms", agent, role)."""

_NOWHERE: frozenset[str] = frozenset()


class Scene:
    """A World and its indexes; takes over from the scene `before` what has not changed."""

    _places: Mapping[tuple[str, str], frozenset[str]]
    _applications: Mapping[str, str]
    _charts: Collection[tuple[str, str]]
    occupied: Occupancy

    def __init__(self, world: World, before: Scene | None = None) -> None:
        self.render: Render = world.render
        self.pins: Mapping[str, Pin] = world.pins
        fleet = housed(world.fleet, world.present.values())
        same = before is not None and before.fleet == fleet
        self.fleet: Fleet = before.fleet if before is not None and same else fleet
        self.selector = _selector(world, before)
        self.present: Mapping[str, Release] = dict(world.present)
        if before is not None and same and before.present == self.present:
            self._places, self._applications, self._charts = before._places, before._applications, before._charts
            self.present = before.present
        else:
            self._places, self._applications, self._charts = _index(self.present, self.fleet)
        self.others: Mapping[str, Release] = dict(world.others)
        if before is not None and same and before.selector is self.selector and before.others == self.others:
            self.occupied = before.occupied
        else:
            self.occupied = _occupied(self.others, self.fleet, self.selector.catalogue)

    def same(self, other: Scene) -> bool:
        """Whether every answer is the same in the other scene, which was made after this one or before it."""
        return (
            self.fleet is other.fleet
            and self.selector is other.selector
            and self.present is other.present
            and self.occupied is other.occupied
            and self.others == other.others
            and self.pins == other.pins
        )

    def kept(self, demand: Demand, name: Any) -> frozenset[str]:
        """Places on which this demand's release of that name runs already."""
        if not isinstance(name, str):
            return _NOWHERE
        return self._places.get((demand.key if demand.task else "", name), _NOWHERE)

    def kept_application(self, demand: Demand) -> str:
        """The application that answers the demand's task on main; empty when none does."""
        return self._applications.get(demand.key, "")

    def answer(self, question: Question) -> Any:
        """What the fleet says now; RefusalError as the fleet raises it."""
        if question[0] == "agent":
            return self.fleet.agent(question[1])
        if question[0] == "role":
            return self.fleet.present(question[1])
        return self.platforms(question[1], question[2])

    def runs(self, place: str, chart: str) -> bool:
        """Whether a release of that chart is on the place already."""
        return (place, chart) in self._charts

    def platforms(self, agent: str, role: str = "") -> frozenset[str]:
        """Platforms of the nodes of an agent, else of all agents of the role; none when one of them is not known."""
        names = [agent] if agent else [found.name for found in self.fleet.of_role.get(role, ())]
        found = {node.platform for name in names for node in self.fleet.nodes.get(name, ())}
        return frozenset() if "" in found else frozenset(found)


def _selector(world: World, before: Scene | None) -> Selector:
    if before is not None and before.selector.serves(world.catalogue, world.withheld, world.schema):
        return before.selector
    return Selector(world.catalogue, world.withheld, world.validate, world.schema)


def _index(
    present: Mapping[str, Release], fleet: Fleet
) -> tuple[dict[tuple[str, str], frozenset[str]], dict[str, str], set[tuple[str, str]]]:
    """(task, release name) -> places that run it, under the empty task for all; task -> application that answers it;
    (place, chart) of every release."""
    places: dict[tuple[str, str], set[str]] = {}
    charts: set[tuple[str, str]] = set()
    applications: dict[str, str] = {}
    for release in present.values():
        found = places_of(release, fleet)
        charts.update((place, release.chart) for place in found)
        for task in ("", *(cause.task for cause in release.causes)):
            places.setdefault((task, release.name), set()).update(found)
        applications.update((cause.task, cause.application) for cause in release.causes)
    return {key: frozenset(found) for key, found in places.items()}, applications, charts


def places_of(release: Release, fleet: Fleet) -> tuple[str, ...]:
    """The place of a release as its values say; else those of its namespace. Of several Nodes it is on the home when it
    names none that is there."""
    agent = placed_on(release, "agent")
    names: tuple[str, ...] = fleet.by_namespace.get(release.namespace, ())
    if agent in fleet.agents and fleet.agents[agent].namespace == release.namespace:
        names = (agent,)
    if fleet.homes.keys().isdisjoint(names):
        return names
    node = placed_on(release, "node")
    found = [fleet.agents[name] for name in names]
    return tuple(p.place if (p := replace(a, node=node)).place in fleet.at else fleet.home(a).place for a in found)


def placed_on(release: Release, key: str) -> str:
    """`agent` or `node` of a release's placement; empty when its values name none."""
    placement = release.values.get("placement")
    found = placement.get(key) if isinstance(placement, Mapping) else None
    return found if isinstance(found, str) else ""


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
        votes = named.get(name, {})
        if name in fleet.agents and (len(nodes) > 1 or any(node.name in votes for node in nodes)):
            homes[name] = _home(nodes, votes)
    return replace(fleet, homes=homes) if homes else fleet


def _home(nodes: Sequence[NodeState], votes: Mapping[str, int]) -> str:
    usable = [node for node in nodes if not node.lost] or nodes
    rank = {n.name: (-votes.get(n.name, 0), not n.ready or n.cordoned, n.created, n.name) for n in usable}
    return min(rank, key=lambda name: rank[name])


def _occupied(others: Mapping[str, Release], fleet: Fleet, catalogue: Catalogue) -> Occupancy:
    found = Occupancy()
    for release in others.values():
        for place in places_of(release, fleet)[:1]:
            found.take(place, need_of(release, catalogue))
    return found


def need_of(release: Release, catalogue: Catalogue) -> Resources:
    """What a release asks for, as the catalogue says it of its chart version; nothing when it is not known there."""
    version = catalogue.version(release.chart, release.version)
    return read_resources(version.resources) if version else NOTHING
