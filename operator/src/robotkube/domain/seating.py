"""Who sits where in one composition so far: room, releases by name, and who keeps away from whom."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from robotkube.domain.capacities import NOTHING, Occupancy, Resources
from robotkube.domain.placement import Circumstances, Fleet, Group, Placement, place
from robotkube.domain.scenes import Scene
from robotkube.domain.tasks import OFFLOAD
from robotkube.domain.worlds import Demand

Words = dict[str, frozenset[str]]
"""Word -> agents, or places."""

_NOBODY: Mapping[str, str] = {}
_NOWHERE: frozenset[str] = frozenset()


class Seating:
    """Grows as demands are placed; `mark` and `undo` take back what a refused demand had taken.

    `watched`: words that some demand keeps away from (Demand.keeps_away): only these are written down."""

    def __init__(self, scene: Scene | None, watched: frozenset[str]) -> None:
        self._watched = watched
        self._named: Words = {}
        self._near: Words = {}
        self._kept_away: Words = {}
        self._apart: Words = {}
        self._journal: list[tuple[Words, str, frozenset[str]]] = []
        self.occupancy = scene.occupied.copy() if scene else Occupancy()
        if scene and watched:
            self._see_others(scene)

    def copy(self) -> Seating:
        """A seating that can grow without changing this one; nothing before it can be undone in it."""
        found = Seating(None, self._watched)
        found._named, found._near = dict(self._named), dict(self._near)
        found._kept_away, found._apart = dict(self._kept_away), dict(self._apart)
        found.occupancy = self.occupancy.copy()
        return found

    def _see_others(self, scene: Scene) -> None:
        for release in scene.others.values():
            agent = scene.fleet.by_namespace.get(release.namespace, ("",))[0]
            self._write(self._near, [release.name, release.key, *(c.task for c in release.causes)], agent)

    def mark(self) -> tuple[int, int]:
        """A point to go back to."""
        return self.occupancy.mark(), len(self._journal)

    def undo(self, mark: tuple[int, int]) -> None:
        """Take back everything since `mark`."""
        self.occupancy.undo(mark[0])
        while len(self._journal) > mark[1]:
            words, word, agents = self._journal.pop()
            words[word] = agents

    def _note(self, words: Words, word: str, agent: str) -> None:
        agents = words.get(word, _NOWHERE)
        if agent not in agents:
            self._journal.append((words, word, agents))
            words[word] = agents | {agent}

    def _write(self, words: Words, found: Iterable[str], agent: str) -> None:
        for word in found:
            if word in self._watched:
                self._note(words, word, agent)

    def seat(
        self, demand: Demand, group: Group, names: Sequence[Any], needs: Sequence[Resources], scene: Scene
    ) -> Placement:
        """Place a group whose releases have these names and ask for this; it sits there from now on.

        A release that another demand makes already is shared: it asks for nothing more."""
        shared = self._shared(names)
        around = Circumstances(
            scene.fleet,
            self.occupancy,
            needs[0] if len(needs) == 1 else sum(needs, NOTHING),
            {agent: _rest(names, needs, found) for agent, found in shared.items()},
            {**self._avoided(demand, group, names), **self._settled(names, scene.fleet)},
            waits=demand.task is None or demand.task.conflict_policy != OFFLOAD,
        )
        placement = place(group, around, self._kept(demand, group, names, scene))
        here = placement.agent.place
        for name, one in zip(names, needs, strict=True):
            if name not in shared.get(here, ()):
                self.occupancy.take(here, one)
                self._note(self._named, str(name), here)
        for word in group.apart:
            self._note(self._apart, word, placement.agent.name)
        if self._watched:
            self._settle(demand, names, placement)
        return placement

    def _kept(self, demand: Demand, group: Group, names: Sequence[Any], scene: Scene) -> Mapping[str, int]:
        """Places on which releases of the group run already, or, of those that are shared, are planned by others."""
        found: dict[str, int] = {}
        for seat, name in zip(group.seats, names, strict=True):
            planned = self._named.get(name, ()) if seat.united else ()
            for agent in (*scene.kept(demand, name), *planned):
                found[agent] = found.get(agent, 0) + 1
        return found

    def _shared(self, names: Sequence[Any]) -> dict[str, set[Any]]:
        """Places on which releases of these names are planned already, with the names."""
        found: dict[str, set[Any]] = {}
        for name in names:
            for agent in self._named.get(name, ()) if isinstance(name, str) else ():
                found.setdefault(agent, set()).add(name)
        return found

    def _settled(self, names: Sequence[Any], fleet: Fleet) -> Mapping[str, str]:
        """Places beside which, on another Node of the same agent, a release of one of these names is planned: an agent
        has one release of a name."""
        if not fleet.homes:
            return _NOBODY
        found: dict[str, str] = {}
        for name in names:
            for here in [fleet.at[taken] for taken in self._named.get(str(name), ()) if taken in fleet.at]:
                why = f"is beside Node {here.node}, where {name} is planned"
                found.update({other.place: why for other in fleet.places(here) if other != here})
        return found

    def _avoided(self, demand: Demand, group: Group, names: Sequence[Any]) -> Mapping[str, str]:
        if not self._watched and not group.apart:
            return _NOBODY
        found: dict[str, str] = {}
        for word in group.apart:
            found.update(dict.fromkeys(self._apart.get(word, ()), "runs another instance, and instances are spread"))
        for word in sorted(demand.keeps_away):
            found.update(dict.fromkeys(self._near.get(word, ()), f"runs {word}, which the task keeps away from"))
        own = [demand.key, *(name for name in names if isinstance(name, str))]
        for word in own if self._watched else ():
            found.update(dict.fromkeys(self._kept_away.get(word, ()), f"runs what keeps away from {word}"))
        return found

    def _settle(self, demand: Demand, names: Sequence[Any], placement: Placement) -> None:
        agent = placement.agent
        words = [demand.key, *map(str, names), *(f"{agent.namespace}/{name}" for name in names)]
        self._write(self._near, words, agent.name)
        self._write(self._kept_away, demand.keeps_away, agent.name)


def _rest(names: Sequence[Any], needs: Sequence[Resources], shared: set[Any]) -> Resources:
    return sum((need for name, need in zip(names, needs, strict=True) if name not in shared), NOTHING)
