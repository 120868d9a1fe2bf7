"""Assignments of releases to places in one composition so far: capacity, releases by name, who keeps away from whom."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.manager.core.composition.index import Index
from robotkube.delivery.manager.core.composition.inputs import Demand
from robotkube.delivery.manager.core.placement.capacity import NOTHING, Occupancy, Resources
from robotkube.delivery.manager.core.placement.placement import Circumstances, Fleet, Group, Placement, place
from robotkube.delivery.tasks.core.task_description import OFFLOAD

Words = dict[str, frozenset[str]]
"""Word -> agents, or places."""

_NOBODY: Mapping[str, str] = {}
_NOWHERE: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Stay:
    """A group whose releases all run on one place and on no other, and stay unless what is planned stands against it;
    `only` has that place alone."""

    place: str
    names: tuple[str, ...]
    need: Resources
    only: frozenset[str]


class Assignments:
    """Assignments that grow as demands are placed; `mark` and `undo` release what a refused demand had reserved.

    `watched`: words that some demand keeps away from (Demand.keeps_away): only these are written down."""

    def __init__(self, index: Index | None, watched: frozenset[str]) -> None:
        self._watched = watched
        self._named: Words = {}
        self._near: Words = {}
        self._kept_away: Words = {}
        self._apart: Words = {}
        self._journal: list[tuple[Words, str, frozenset[str]]] = []
        self.occupancy = index.occupied.copy() if index else Occupancy()
        if index and watched:
            self._note_others(index)

    def copy(self) -> Assignments:
        """Assignments that can grow without changing these; nothing before them can be undone in them."""
        copied = Assignments(None, self._watched)
        copied._named = dict(self._named)
        copied._near = dict(self._near)
        copied._kept_away = dict(self._kept_away)
        copied._apart = dict(self._apart)
        copied.occupancy = self.occupancy.copy()
        return copied

    def _note_others(self, index: Index) -> None:
        for release in index.others.values():
            agent = index.fleet.by_namespace.get(release.namespace, ("",))[0]
            self._write(self._near, [release.name, release.key, *(c.task for c in release.causes)], agent)

    def mark(self) -> tuple[int, int]:
        """A point to go back to."""
        return self.occupancy.mark(), len(self._journal)

    def undo(self, mark: tuple[int, int]) -> None:
        """Undo everything since `mark`."""
        self.occupancy.undo(mark[0])
        while len(self._journal) > mark[1]:
            words, word, agents = self._journal.pop()
            words[word] = agents

    def _note(self, words: Words, word: str, agent: str) -> None:
        agents = words.get(word, _NOWHERE)
        if agent not in agents:
            self._journal.append((words, word, agents))
            words[word] = agents | {agent}

    def _write(self, words: Words, written: Iterable[str], agent: str) -> None:
        for word in written:
            if word in self._watched:
                self._note(words, word, agent)

    def assign(self, demand: Demand, group: Group, names: Sequence[Any], index: Index) -> Placement:
        """Place a group whose releases have these names; it is assigned to that place from now on.

        A release that another demand makes already is shared: it asks for nothing more."""
        shared = self._shared(names)
        around = Circumstances(
            index.fleet,
            self.occupancy,
            group.need,
            {agent: _rest(names, group, there) for agent, there in shared.items()},
            {**self._avoided(demand, group, names), **self._beside(names, index.fleet), **index.forbidden(group)},
            waits=demand.task is None or demand.task.conflict_policy != OFFLOAD,
        )
        placement = place(group, around, self._kept(demand, group, names, index))
        here = placement.agent.place
        for name, request in zip(names, group.requests, strict=True):
            if name not in shared.get(here, ()):
                self.occupancy.reserve(here, request.need)
                self._note(self._named, str(name), here)
        for word in group.apart:
            self._note(self._apart, word, placement.agent.name)
        if self._watched:
            self._keep_away(demand, names, placement)
        return placement

    def stay(self, stays: Iterable[Stay], fleet: Fleet) -> bool:
        """Assign groups as `assign` does, when they simply stay: nobody keeps away from anything, nothing else of their
        names is planned, and there is room. Else False, and nothing is assigned that `undo` does not take back."""
        if self._watched:
            return False
        for one in stays:
            if not self._named.keys().isdisjoint(one.names):
                return False
            if not self.occupancy.fits(one.place, fleet.capacities.get(one.place), one.need):
                return False
            self.occupancy.reserve(one.place, one.need, len(one.names))
            for name in one.names:
                self._journal.append((self._named, name, _NOWHERE))
                self._named[name] = one.only
        return True

    def _kept(self, demand: Demand, group: Group, names: Sequence[Any], index: Index) -> Mapping[str, int]:
        """Places on which releases of the group run already, or, of those that are shared, are planned by others."""
        running: dict[str, int] = {}
        for request, name in zip(group.requests, names, strict=True):
            planned = self._named.get(name, ()) if request.merged else ()
            for place_name in (*index.kept(demand, name), *planned):
                running[place_name] = running.get(place_name, 0) + 1
        return running

    def _shared(self, names: Sequence[Any]) -> dict[str, set[Any]]:
        """Places on which releases of these names are planned already, with the names."""
        shared: dict[str, set[Any]] = {}
        for name in names:
            for here in self._named.get(name, ()) if isinstance(name, str) else ():
                shared.setdefault(here, set()).add(name)
        return shared

    def _beside(self, names: Sequence[Any], fleet: Fleet) -> Mapping[str, str]:
        """Places beside which, on another Node of the same agent, a release of one of these names is planned: an agent
        has one release of a name."""
        if not fleet.homes:
            return _NOBODY
        beside: dict[str, str] = {}
        for name in names:
            for here in [fleet.at[planned] for planned in self._named.get(str(name), ()) if planned in fleet.at]:
                why = f"is beside Node {here.node}, where {name} is planned"
                beside.update({other.place: why for other in fleet.places(here) if other != here})
        return beside

    def _avoided(self, demand: Demand, group: Group, names: Sequence[Any]) -> Mapping[str, str]:
        if not self._watched and not group.apart:
            return _NOBODY
        avoided: dict[str, str] = {}
        for word in group.apart:
            avoided.update(dict.fromkeys(self._apart.get(word, ()), "runs another instance, and instances are spread"))
        for word in sorted(demand.keeps_away):
            avoided.update(dict.fromkeys(self._near.get(word, ()), f"runs {word}, which the task keeps away from"))
        own = [demand.key, *(name for name in names if isinstance(name, str))]
        for word in own if self._watched else ():
            avoided.update(dict.fromkeys(self._kept_away.get(word, ()), f"runs what keeps away from {word}"))
        return avoided

    def _keep_away(self, demand: Demand, names: Sequence[Any], placement: Placement) -> None:
        agent = placement.agent
        words = [demand.key, *map(str, names), *(f"{agent.namespace}/{name}" for name in names)]
        self._write(self._near, words, agent.name)
        self._write(self._kept_away, demand.keeps_away, agent.name)


def stay_of(group: Group, names: Sequence[Any], placement: Placement, fleet: Fleet) -> Stay | None:
    """The group as one that stays where it was just placed; None when more than room and names could move it."""
    here = placement.agent.place
    bound = fleet.homes or group.apart or any(request.links for request in group.requests)
    if bound or group.kept != {here: len(names)}:
        return None
    if placement is not fleet.candidates(group.wanted).stays(placement.agent, group.together):
        return None
    return Stay(here, tuple(names), group.need, frozenset([here]))


def _rest(names: Sequence[Any], group: Group, shared: set[Any]) -> Resources:
    pairs = zip(names, group.requests, strict=True)
    return sum((request.need for name, request in pairs if name not in shared), NOTHING)
