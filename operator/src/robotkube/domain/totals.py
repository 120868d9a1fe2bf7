"""All demands that are met so far in one composition: who asks for which release, and what the releases are at the end.

A total can be copied cheaply: its values are never changed in place. So composing again begins where the demands begin
to differ from those of the last time.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from hashlib import sha256

from robotkube.domain.capacities import read_resources
from robotkube.domain.catalogue import Pin
from robotkube.domain.drafts import Draft, make_release
from robotkube.domain.errors import DocumentError, RefusalError
from robotkube.domain.loops import fill
from robotkube.domain.placement import Agent
from robotkube.domain.releases import Cause, Release
from robotkube.domain.scenes import Scene
from robotkube.domain.seating import Seating
from robotkube.domain.tasks import INSUFFICIENT_RESOURCES, RELEASE_IN_USE
from robotkube.domain.topic_unions import End, Part, TopicUnion
from robotkube.domain.unions import united
from robotkube.domain.worlds import Demand, Desired, Met, Refused

NODE_WORD_MAX = 20


@dataclass(frozen=True)
class Entry:
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


class SpoiledError(Exception):
    """A bridge cannot be made for these demands together: `demands` are to be refused, with `refused`."""

    def __init__(self, demands: list[str], refused: Refused) -> None:
        super().__init__(refused.message)
        self.demands, self.refused = demands, refused


@dataclass(frozen=True)
class _Bridge:
    """A bridge as it was made, and of what."""

    parts: tuple[Part, ...]
    agent: Agent
    home: Agent
    platforms: frozenset[str]
    pin: Pin | None
    release: Release

    def fits(self, parts: tuple[Part, ...], scene: Scene, place: str) -> bool:
        """Whether it would be made the same again."""
        return (
            len(parts) == len(self.parts)
            and all(a is b for a, b in zip(parts, self.parts, strict=True))
            and scene.fleet.at.get(place) == self.agent
            and scene.fleet.home(self.agent) == self.home
            and scene.platforms(self.agent.name) == self.platforms
            and scene.pins.get(self.release.key) == self.pin
        )


@dataclass
class Known:
    """What was made once: a bridge of these parts, a release with these causes, a union of two releases."""

    bridges: dict[End, _Bridge] = field(default_factory=dict)
    final: dict[str, tuple[Release, tuple[Cause | None, ...], Release | None, Release]] = field(default_factory=dict)
    unions: dict[str, tuple[Release, Release, Release]] = field(default_factory=dict)


class Total:
    """All demands so far in one scene. `outcomes` by demand key, `first` of equal demands by their shared key."""

    def __init__(self, scene: Scene, seating: Seating, known: Known) -> None:
        self.scene, self._known = scene, known
        self.seating = seating
        self.outcomes: dict[str, Entry | Refused] = {}
        self.first: dict[str, Entry] = {}
        self._releases: dict[str, Release] = {}
        self._causes: dict[str, tuple[Cause | None, ...]] = {}
        self._askers: dict[str, tuple[str, ...]] = {}
        self._topics = TopicUnion()
        self._bridged: dict[End, tuple[Entry, ...]] = {}
        self._bridge_keys: dict[End, str] = {}
        self._changed: dict[str, None] = {}
        self._changed_ends: dict[End, None] = {}
        self._final: dict[str, Release] = {}
        self._initial: set[str] = set()
        self._answers: dict[str, Met | Refused] = {}

    def copy(self, scene: Scene) -> Total:
        """A total that can grow without changing this one; `scene` is equal to the one it was made in."""
        found = Total(scene, self.seating.copy(), self._known)
        found.outcomes, found.first = dict(self.outcomes), dict(self.first)
        found._releases, found._causes, found._askers = dict(self._releases), dict(self._causes), dict(self._askers)
        found._topics, found._bridged = self._topics.copy(), dict(self._bridged)
        found._bridge_keys, found._final = dict(self._bridge_keys), dict(self._final)
        found._changed, found._changed_ends = dict(self._changed), dict(self._changed_ends)
        found._initial, found._answers = set(self._initial), dict(self._answers)
        return found

    def merge(self, entry: Entry) -> None:
        """Take an entry's draft in, or raise RefusalError and leave everything but the seating as it was."""
        draft = entry.draft
        releases = {key: self._joined(key, release, draft) for key, release in draft.releases.items()}
        if not entry.shares:
            self._seat_bridges(draft)
        self._topics.merge(draft.topics)
        self._releases.update(releases)
        cause = entry.cause
        for key in releases:
            self._causes[key] = (*self._causes.get(key, ()), cause)
            self._askers[key] = (*self._askers.get(key, ()), entry.demand.key)
            self._changed[key] = None
        for end in draft.topics.ends:
            self._bridged[end] = (*self._bridged.get(end, ()), entry)
            self._changed_ends[end] = None

    def _joined(self, key: str, release: Release, draft: Draft) -> Release:
        """The release for all demands so far: the same for all, or a union where the application allows it."""
        present = self._releases.get(key)
        if present is None or present is release or present == release:
            return release if present is None else present
        known = self._known.unions.get(key)
        if known and known[0] is present and known[1] is release:
            return known[2]
        found = united(present, release, draft.unite[key])
        if found is None:
            names = ", ".join(self._askers[key])
            raise RefusalError(RELEASE_IN_USE, f"release {key} is made by {names} with other content")
        self._known.unions[key] = (present, release, found)
        return found

    def _seat_bridges(self, draft: Draft) -> None:
        """Bridges that nobody asked for yet need room as well; those that run already keep it."""
        scene, occupancy = self.scene, self.seating.occupancy
        for end in draft.topics.ends:
            if end in self._bridged:
                continue
            chart, place = scene.selector.bridge(end[0])[1][0], end[1]
            need, room = read_resources(chart.resources), scene.fleet.rooms.get(place)
            if room and not occupancy.fits(place, room, need) and not scene.runs(place, chart.chart):
                shortage, agent = occupancy.shortage(place, room, need), scene.fleet.at[place]
                text = f"{agent} has no room for its bridge ({shortage}); withdraw something that runs there"
                raise RefusalError(INSUFFICIENT_RESOURCES, text)
            occupancy.take(place, need, releases=0)

    def settle(self) -> None:
        """Make the bridges and write the causes of everything that changed since the last time. SpoiledError when a
        bridge cannot be made."""
        for end in self._changed_ends:
            release = self._bridge(end)
            if self._bridge_keys.setdefault(end, release.key) != release.key:
                self._answers.clear()  # demands name their bridges
            self._bridge_keys[end] = release.key
            self._releases[release.key] = release
            self._causes[release.key] = tuple(entry.cause for entry in self._bridged[end])
            self._changed[release.key] = None
        for key in self._changed:
            found = self._with_causes(key, self._releases[key], self._causes[key])
            self._final[found.path] = found
            if None in self._causes[key]:
                self._initial.add(found.path)
        for demand, outcome in self.outcomes.items():
            if demand not in self._answers:
                self._answers[demand] = self._answer(outcome)
        self._changed.clear()
        self._changed_ends.clear()

    def desired(self) -> Desired:
        """What is settled. What main has already is taken as it is there, its plan included."""
        return Desired(dict(self._final), dict(self._answers), frozenset(self._initial))

    def _answer(self, outcome: Entry | Refused) -> Met | Refused:
        if isinstance(outcome, Refused):
            return outcome
        draft = outcome.draft
        keys = {*draft.releases, *(self._bridge_keys[end] for end in draft.topics.ends)}
        return Met(tuple(sorted(keys)), outcome.choices, draft.application)

    def _bridge(self, end: End) -> Release:
        """The bridge of one place for all demands; the one known when its parts are the same."""
        parts, scene = self._topics.parts[end], self.scene
        known = self._known.bridges.get(end)
        if known and known.fits(parts, scene, end[1]):
            return known.release
        try:
            release = self._make_bridge(end, self._topics)
        except (RefusalError, DocumentError) as error:
            raise self._spoiled(end, error) from error
        agent, pin = scene.fleet.at[end[1]], scene.pins.get(release.key)
        home, platforms = scene.fleet.home(agent), scene.platforms(agent.name)
        self._known.bridges[end] = _Bridge(parts, agent, home, platforms, pin, release)
        return release

    def _make_bridge(self, end: End, topics: TopicUnion) -> Release:
        scene, service = self.scene, self.scene.selector.bridge(end[0])[0]
        agent = scene.fleet.at[end[1]]
        names = {"agent": agent.name, "topics": topics.at(*end)}
        name = f"{scene.render(service.release, names)}{_node_suffix(agent.node)}"
        pin = scene.pins.get(f"{agent.namespace}/{name}")
        chart, _ = scene.selector.chart(service.chart, platforms=scene.platforms(agent.name), pinned=pin)
        away = agent != scene.fleet.home(agent)
        return make_release(agent, name, chart, fill(service.values, names, scene.render), scene, movable=away)

    def _spoiled(self, end: End, error: RefusalError | DocumentError) -> SpoiledError:
        """Refuse the demands whose own topics make the bridge impossible, else the last that came."""
        reason = error.reason if isinstance(error, RefusalError) else "CompositionFailed"
        message = error.message if isinstance(error, RefusalError) else str(error)
        entries = self._bridged[end]
        guilty = [entry for entry in entries if self._fails_alone(end, entry)]
        return SpoiledError([entry.demand.key for entry in guilty or entries[-1:]], Refused(reason, message))

    def _fails_alone(self, end: End, entry: Entry) -> bool:
        try:
            self._make_bridge(end, entry.draft.topics)
        except (RefusalError, DocumentError):
            return True
        return False

    def _with_causes(self, key: str, release: Release, causes: tuple[Cause | None, ...]) -> Release:
        present, known = self.scene.present.get(release.path), self._known.final.get(key)
        if known and known[0] is release and known[2] is present and known[1] == causes:
            return known[3]
        found = replace(release, causes=tuple(sorted({cause for cause in causes if cause})))
        if present is not None and present.same_but_plan(found):
            found = present
        self._known.final[key] = (release, causes, present, found)
        return found


def _node_suffix(node: str) -> str:
    """What tells the bridges of an agent's Nodes apart; a long name of a Node by its hash, since the names of releases
    are short."""
    word = node.replace(".", "-")
    if len(word) > NODE_WORD_MAX:
        word = sha256(node.encode()).hexdigest()[:8]
    return f"-{word}" if word else ""
