"""Demands -> the releases that should exist, with reasons; a demand that cannot be met is refused and leaves no trace.

Services become releases; services with links of kind ros share a node; links of kind mqtt become topics of the bridge
release at both ends, as the union over all demands, so that no message crosses twice. Demands are met in the order in
which they are given: what comes first has its seat first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from robotkube.domain.capacities import read_resources
from robotkube.domain.catalogue import Pin
from robotkube.domain.drafts import Draft, Drafter, make_release
from robotkube.domain.errors import DocumentError, RefusalError
from robotkube.domain.loops import fill
from robotkube.domain.placement import Agent
from robotkube.domain.releases import Cause, Release
from robotkube.domain.scenes import Scene
from robotkube.domain.seating import Seating
from robotkube.domain.tasks import INSUFFICIENT_RESOURCES, RELEASE_IN_USE
from robotkube.domain.topic_unions import End, Part, TopicUnion
from robotkube.domain.unions import united
from robotkube.domain.values_schemas import Validate
from robotkube.domain.worlds import Demand, Desired, Met, Refused, World

__all__ = ["Composer", "Demand", "Desired", "Met", "Refused", "Validate", "World", "compose"]

DRAFTS_KEPT_MAX = 4096


class _StaleError(Exception):
    """A draft no longer fits what it is looked at in."""


@dataclass(frozen=True)
class _Entry:
    """A demand that is met: its draft; `shares` names the earlier equal demand whose draft it is."""

    demand: Demand
    draft: Draft
    shares: str = ""

    @property
    def cause(self) -> Cause | None:
        """The task's cause under the application that answers it; None for the initial configuration."""
        if self.demand.task is None or not self.shares:
            return self.draft.cause
        return replace(self.demand.task.cause, application=self.draft.application)

    @property
    def choices(self) -> tuple[str, ...]:
        """Every choice in words."""
        return (f"shares the releases of {self.shares}",) if self.shares else self.draft.choices


@dataclass
class _Total:
    """All demands so far: releases by key with the causes that ask for each (None: the initial configuration)."""

    seating: Seating
    releases: dict[str, Release] = field(default_factory=dict)
    causes: dict[str, list[Cause | None]] = field(default_factory=dict)
    askers: dict[str, list[str]] = field(default_factory=dict)
    topics: TopicUnion = field(default_factory=TopicUnion)
    bridged: dict[End, list[_Entry]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Bridge:
    """A bridge as it was made, and of what."""

    parts: list[Part]
    agent: Agent
    platforms: frozenset[str]
    pin: Pin | None
    release: Release

    def fits(self, parts: list[Part], scene: Scene, agent: str) -> bool:
        """Whether it would be made the same again."""
        return (
            len(parts) == len(self.parts)
            and all(a is b for a, b in zip(parts, self.parts, strict=True))
            and scene.fleet.agents.get(agent) == self.agent
            and scene.platforms(agent) == self.platforms
            and scene.pins.get(self.release.key) == self.pin
        )


@dataclass
class _Known:
    """What was made once: a bridge of these parts, a release with these causes, a union of two releases."""

    bridges: dict[End, _Bridge] = field(default_factory=dict)
    final: dict[str, tuple[Release, list[Cause | None], Release]] = field(default_factory=dict)
    unions: dict[str, tuple[Release, Release, Release]] = field(default_factory=dict)


class Composer:
    """Composes again and again; keeps what it drafted as long as its inputs stay, and gives the same answer as from
    scratch. Not for several threads at once."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._drafts: dict[str, Draft] = {}
        self._known = _Known()

    def compose(self, demands: Iterable[Demand], world: World) -> Desired:
        """Meet the demands in this order. Desired has one outcome for each; nothing is raised."""
        asked = list(demands)
        scene = Scene(world, self._scene)
        if self._scene is None or scene.selector is not self._scene.selector:
            self._drafts, self._known = {}, _Known()
        self._scene = scene
        composition = _Composition(scene, self._drafts, self._known, {})
        desired = composition.run(asked)
        while desired is None:  # a bridge cannot be: each time one demand more is left out
            composition = _Composition(scene, self._drafts, self._known, composition.spoilers)
            desired = composition.run(asked)
        self._keep(composition.drafts)
        return desired

    def _keep(self, drafts: Mapping[str, Draft]) -> None:
        """Those of this run are the newest; demands that were left out of it for a trial may come back."""
        for key, draft in drafts.items():
            self._drafts.pop(key, None)
            self._drafts[key] = draft
        while len(self._drafts) > max(DRAFTS_KEPT_MAX, len(drafts)):
            self._drafts.pop(next(iter(self._drafts)))


def compose(demands: Iterable[Demand], world: World) -> Desired:
    """Meet the demands in this order, from scratch."""
    return Composer().compose(demands, world)


class _Composition:
    """One run over all demands; `drafts` from earlier runs are used where they still hold. `spoilers`: demands that are
    refused because a bridge cannot be made with them."""

    def __init__(
        self, scene: Scene, drafts: Mapping[str, Draft], known: _Known, spoilers: Mapping[str, Refused]
    ) -> None:
        self._scene, self._old, self._known = scene, drafts, known
        self.spoilers: dict[str, Refused] = dict(spoilers)
        self.drafts: dict[str, Draft] = {}

    def run(self, demands: list[Demand]) -> Desired | None:
        """The answer; None when another demand has become a spoiler."""
        watched = frozenset(word for demand in demands for word in demand.keeps_away)
        self._total = _Total(Seating(self._scene, watched))
        outcomes: dict[str, _Entry | Refused] = {}
        first: dict[str, _Entry] = {}
        for demand in demands:
            outcomes[demand.key] = self.spoilers.get(demand.key) or self._meet(demand, first)
        return self._finish(outcomes)

    def _meet(self, demand: Demand, first: dict[str, _Entry]) -> _Entry | Refused:
        equal = first.get(demand.shared_key)
        mark = self._total.seating.mark()
        try:
            entry = _Entry(demand, equal.draft, equal.demand.key) if equal else _Entry(demand, self._draft(demand))
            self._merge(entry)
        except RefusalError as error:
            self._total.seating.undo(mark)
            return Refused(error.reason, error.message)
        except DocumentError as error:
            self._total.seating.undo(mark)
            return Refused("CompositionFailed", str(error))
        if not equal:
            first[demand.shared_key] = entry
            self.drafts[demand.key] = entry.draft
        return entry

    def _draft(self, demand: Demand) -> Draft:
        """The known draft when it still holds, seated; else a new one."""
        known, seating = self._old.get(demand.key), self._total.seating
        if known is not None and (known.demand is demand or known.demand == demand):
            mark = seating.mark()
            try:
                return self._seated(known, demand)
            except (_StaleError, RefusalError):
                seating.undo(mark)
        return Drafter(demand, self._scene, seating).draft()

    def _seated(self, draft: Draft, demand: Demand) -> Draft:
        scene = self._scene
        if draft.fleet is not scene.fleet:
            if any(scene.answer(question) != answer for question, answer in draft.questions):
                raise _StaleError
            draft.fleet = scene.fleet
        if any(scene.pins.get(key) != pin for key, pin in draft.pins):
            raise _StaleError
        changed = False
        for step in draft.steps:
            placement = self._total.seating.seat(demand, step.group, step.names, step.needs, scene)
            if placement.agent != step.placement.agent:
                raise _StaleError
            changed |= placement is not step.placement and placement.reasons != step.placement.reasons
            step.placement = placement
        if changed:
            draft.choose()
        return draft

    def _merge(self, entry: _Entry) -> None:
        """Take the draft into the total, or raise and leave the total as it was."""
        total, draft = self._total, entry.draft
        releases = {key: self._joined(key, release, draft) for key, release in draft.releases.items()}
        if not entry.shares:
            self._seat_bridges(draft)
        total.topics.merge(draft.topics)
        total.releases.update(releases)
        cause = entry.cause
        for key in releases:
            total.causes.setdefault(key, []).append(cause)
            total.askers.setdefault(key, []).append(entry.demand.key)
        for end in draft.topics.ends:
            total.bridged.setdefault(end, []).append(entry)

    def _joined(self, key: str, release: Release, draft: Draft) -> Release:
        """The release for all demands so far: the same for all, or a union where the application allows it."""
        present = self._total.releases.get(key)
        if present is None or present is release or present == release:
            return release if present is None else present
        known = self._known.unions.get(key)
        if known and known[0] is present and known[1] is release:
            return known[2]
        found = united(present, release, draft.unite[key])
        if found is None:
            names = ", ".join(self._total.askers[key])
            raise RefusalError(RELEASE_IN_USE, f"release {key} is made by {names} with other content")
        self._known.unions[key] = (present, release, found)
        return found

    def _seat_bridges(self, draft: Draft) -> None:
        """Bridges that nobody asked for yet need room as well; those that run already keep it."""
        total, scene = self._total, self._scene
        for end in draft.topics.ends:
            if end in total.bridged:
                continue
            chart, agent = scene.selector.bridge(end[0])[1][0], end[1]
            need, room = read_resources(chart.resources), scene.fleet.rooms.get(agent)
            occupancy = total.seating.occupancy
            if room and not occupancy.fits(agent, room, need) and not scene.runs(agent, chart.chart):
                shortage = occupancy.shortage(agent, room, need)
                text = f"{agent} has no room for its bridge ({shortage}); withdraw something that runs there"
                raise RefusalError(INSUFFICIENT_RESOURCES, text)
            occupancy.take(agent, need, releases=0)

    def _finish(self, outcomes: Mapping[str, _Entry | Refused]) -> Desired | None:
        """Add the bridges, write every release's causes, and name each demand's releases."""
        total = self._total
        keys: dict[End, str] = {}
        for end, entries in sorted(total.bridged.items(), key=lambda item: item[0]):
            try:
                release = self._bridge(end)
            except (RefusalError, DocumentError) as error:
                self._blame(end, entries, error)
                return None
            keys[end] = release.key
            total.releases[release.key] = release
            total.causes[release.key] = [entry.cause for entry in entries]
        final = {}
        for key, release in total.releases.items():
            found = self._with_causes(key, release, total.causes[key])
            final[found.path] = found
        initial = frozenset(total.releases[key].path for key, causes in total.causes.items() if None in causes)
        return Desired(final, {key: _outcome(found, keys) for key, found in outcomes.items()}, initial)

    def _bridge(self, end: End) -> Release:
        """The bridge of one agent for all demands; the one known when its parts are the same."""
        parts, scene = self._total.topics.parts[end], self._scene
        known = self._known.bridges.get(end)
        if known and known.fits(parts, scene, end[1]):
            return known.release
        release = self._make_bridge(end, self._total.topics.at(*end))
        self._known.bridges[end] = _Bridge(
            list(parts), scene.fleet.agents[end[1]], scene.platforms(end[1]), scene.pins.get(release.key), release
        )
        return release

    def _make_bridge(self, end: End, topics: Mapping[str, object]) -> Release:
        scene, service = self._scene, self._scene.selector.bridge(end[0])[0]
        agent, names = scene.fleet.agent(end[1]), {"agent": end[1], "topics": topics}
        name = scene.render(service.release, names)
        pin = scene.pins.get(f"{agent.namespace}/{name}")
        chart, _ = scene.selector.chart(service.chart, platforms=scene.platforms(agent.name), pinned=pin)
        return make_release(agent, name, chart, fill(service.values, names, scene.render), scene)

    def _blame(self, end: End, entries: list[_Entry], error: RefusalError | DocumentError) -> None:
        """Refuse the demands whose own topics make the bridge impossible, else the last that came."""
        refused = Refused(error.reason if isinstance(error, RefusalError) else "CompositionFailed", str(error))
        guilty = [entry for entry in entries if self._spoils(end, entry)]
        for entry in guilty or entries[-1:]:
            self.spoilers[entry.demand.key] = refused

    def _spoils(self, end: End, entry: _Entry) -> bool:
        try:
            self._make_bridge(end, entry.draft.topics.at(*end))
        except (RefusalError, DocumentError):
            return True
        return False

    def _with_causes(self, key: str, release: Release, causes: list[Cause | None]) -> Release:
        known = self._known.final.get(key)
        if known and known[0] is release and known[1] == causes:
            return known[2]
        found = replace(release, causes=tuple(sorted({cause for cause in causes if cause})))
        self._known.final[key] = (release, causes, found)
        return found


def _outcome(found: _Entry | Refused, bridges: Mapping[End, str]) -> Met | Refused:
    if isinstance(found, Refused):
        return found
    keys = {*found.draft.releases, *(bridges[end] for end in found.draft.topics.ends)}
    return Met(tuple(sorted(keys)), found.choices, found.draft.application)
