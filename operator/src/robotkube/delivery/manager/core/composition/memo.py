"""Memo of composition: results that are computed again only when the inputs that they follow from have changed.

Everything that composition remembers is here, bounded. A result is kept with the inputs that it was computed from and
used again when these are the same, so that composing with a memo gives what composing without one gives. Results hold
for one catalogue: with another one (or other versions withheld) all of them are dropped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.accumulated_state import (
    AccumulatedState,
    Contribution,
    caused,
    met,
)
from robotkube.delivery.manager.core.composition.assignments import Assignments, Stay, stay_of
from robotkube.delivery.manager.core.composition.bridges import bridge_release
from robotkube.delivery.manager.core.composition.expansion import Expansion, expand
from robotkube.delivery.manager.core.composition.index import Index, different, housed, occupied, placed_on
from robotkube.delivery.manager.core.composition.inputs import Demand, Inputs, Met, Refused
from robotkube.delivery.manager.core.composition.release_merge import merged_release
from robotkube.delivery.manager.core.composition.selection import Chosen, Selector
from robotkube.delivery.manager.core.composition.topic_merge import End
from robotkube.delivery.manager.core.placement.placement import Agent, Fleet, Placement
from robotkube.errors import RefusalError
from robotkube.registry.catalogue.core.applications import ChartRequirement
from robotkube.registry.catalogue.core.catalogue import Pin
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.guarantees import GuaranteeRequirement

KEPT_MAX = 16384
PREFIXES_APART = 64  # demands between two states from which composing can go on
PREFIXES_BETWEEN_MAX = 3

Key = TypeVar("Key")
Value = TypeVar("Value")


class Recent(dict[Key, Value], Generic[Key, Value]):
    """The values kept last, at most `kept_max`."""

    def __init__(self, kept_max: int) -> None:
        super().__init__()
        self._kept_max = kept_max

    def keep(self, key: Key, value: Value) -> None:
        """Keep a value, and drop the one that was kept first when there are too many."""
        self.pop(key, None)
        self[key] = value
        if len(self) > self._kept_max:
            self.pop(next(iter(self)))


class RecentSelector(Selector):
    """A Selector that chooses once for the same requirement, and checks equal values of a release once."""

    def __init__(self, inputs: Inputs, kept_max: int) -> None:
        super().__init__(inputs.catalogue, inputs.withheld, inputs.validate, inputs.schema)
        self._charts: Recent[Any, Chosen | RefusalError] = Recent(kept_max)
        self._good: Recent[str, tuple[ChartVersion, Mapping[str, Any]]] = Recent(kept_max)

    def chart(
        self,
        requirement: ChartRequirement,
        more: tuple[GuaranteeRequirement, ...] = (),
        platforms: frozenset[str] = frozenset(),
        pinned: Pin | None = None,
    ) -> Chosen:
        """As Selector.chart."""
        key = (requirement, more, platforms, pinned)
        chosen = self._charts.get(key)
        if chosen is None:
            try:
                chosen = super().chart(requirement, more, platforms, pinned)
            except RefusalError as error:
                chosen = error
            self._charts.keep(key, chosen)
        if isinstance(chosen, RefusalError):
            raise RefusalError(chosen.reason, chosen.message)
        return chosen

    def check_values(self, chart: ChartVersion, values: Mapping[str, Any], key: str) -> None:
        """As Selector.check_values."""
        good = self._good.get(key)
        if good is None or good[0] is not chart or good[1] != values:
            super().check_values(chart, values, key)
            self._good.keep(key, (chart, values))


@dataclass
class _KnownContribution:
    """A contribution, and the fleet in which its lookups were answered last; `stays` are its groups, when all of them
    stay where they are in that fleet unless what is planned stands against it."""

    contribution: Contribution
    fleet: Fleet
    stays: Sequence[Stay] = ()


@dataclass
class _KnownBridge:
    """A bridge as it was made, and of what; `fleet` is the one in which `surroundings` was answered last."""

    release: Release
    key: str
    contributions: Sequence[Contribution]
    pin: Pin | None
    fleet: Fleet
    surroundings: tuple[Agent | None, Agent, frozenset[str]]


@dataclass(frozen=True)
class _KnownRelease:
    """A release with its causes, and what it was made of."""

    written: Release
    release: Release
    contributions: Sequence[Contribution]
    path: str
    present: Release | None


@dataclass
class _Run:
    """One pass over the demands, and the states after some of them, by their number."""

    index: Index
    watched: frozenset[str]
    demands: Sequence[Demand]
    first_new: int
    states: dict[int, AccumulatedState] = field(default_factory=dict)

    def common(self, demands: Sequence[Demand]) -> int:
        """How many demands at the beginning are the same."""
        for number, (mine, other) in enumerate(zip(self.demands, demands, strict=False)):
            if mine is not other and mine != other:
                return number
        return min(len(self.demands), len(demands))

    def note(self, number: int, state: AccumulatedState) -> None:
        """Keep the state after `number` demands where the next pass may begin; between regular numbers the last few."""
        if number not in (self.first_new, len(self.demands)) and number % PREFIXES_APART:
            return
        if number and number not in self.states:
            self.states[number] = state.copy()
        between = sorted(kept for kept in self.states if kept % PREFIXES_APART)
        for kept in between[:-PREFIXES_BETWEEN_MAX]:
            del self.states[kept]


class Memo:
    """Results of earlier compositions, at most `kept_max` of each kind; of none with 0. Not for several threads."""

    def __init__(self, kept_max: int = KEPT_MAX) -> None:
        self._kept_max = kept_max
        self._index: Index | None = None
        self._fleet: Fleet | None = None
        self._seen: frozenset[str] = frozenset()
        self._forget()

    def _forget(self) -> None:
        self._contributions: Recent[str, _KnownContribution] = Recent(self._kept_max)
        self._merged: Recent[tuple[int, int], tuple[Release, Release, Sequence[str], Release | None]]
        self._merged = Recent(self._kept_max)
        self._bridges: Recent[End, _KnownBridge] = Recent(self._kept_max)
        self._written: Recent[str, _KnownRelease] = Recent(self._kept_max)
        self._met: Recent[str, tuple[Contribution, Sequence[str], Met]] = Recent(self._kept_max)
        self._run: _Run | None = None

    # -- the index ------------------------------------------------------------------------------------------------

    def index(self, inputs: Inputs) -> Index:
        """The index of the inputs: the last one as long as it answers alike, else with what has not changed of it."""
        before = self._index if self._kept_max else None
        if before is None or not before.selector.serves(inputs) or before.render != inputs.render:
            self._forget()
            before = None
        if before is not None and self._fleet is inputs.fleet and _homes_stay(before.present, inputs.present):
            fleet = before.fleet
        else:
            fleet = housed(inputs.fleet, inputs.present.values())
            fleet = before.fleet if before is not None and before.fleet == fleet else fleet
        if before is not None and before.fleet is fleet and before.others == inputs.others:
            occupancy = before.occupied
        else:
            occupancy = occupied(inputs.others, fleet, inputs.catalogue)
        selector = before.selector if before else RecentSelector(inputs, self._kept_max)
        self._fleet = inputs.fleet
        if before is None or not before.answers(inputs, fleet, selector, occupancy):
            known = before if before is not None and before.fleet is fleet else None
            self._index = before = Index(inputs, fleet, selector, occupancy, known)
        return before

    # -- prefixes of the demands ----------------------------------------------------------------------------------

    @property
    def prefixes(self) -> int:
        """How many states are kept from which composing can go on."""
        return len(self._run.states) if self._run else 0

    def prefix(
        self, demands: Sequence[Demand], impossible: Mapping[str, Refused], index: Index
    ) -> tuple[int, AccumulatedState]:
        """How many demands at the beginning are met as the last time, and the state after them."""
        watched = frozenset(word for demand in demands for word in demand.keeps_away)
        last, self._run = self._run, None
        if self._kept_max and not impossible:
            seen = self._seen
            self._seen = frozenset(demand.key for demand in demands)
            numbers = (number for number, demand in enumerate(demands) if demand.key not in seen)
            first_new = next(numbers, len(demands))
            self._run = _Run(index, watched, demands, first_new)
            if last is not None and last.watched == watched and last.index is index:
                common = last.common(demands)
                self._run.states = {number: state for number, state in last.states.items() if number <= common}
        number = max(self._run.states, default=0) if self._run else 0
        if self._run and number:
            return number, self._run.states[number].copy()
        return 0, AccumulatedState(Assignments(index, watched))

    def note(self, number: int, state: AccumulatedState) -> None:
        """Remember the state after `number` demands, if the next composition may begin there."""
        if self._run:
            self._run.note(number, state)

    # -- one demand -----------------------------------------------------------------------------------------------

    def contribution(
        self, demand: Demand, equal: Contribution | None, index: Index, assignments: Assignments
    ) -> Contribution:
        """What a demand adds, its groups assigned; `equal` is the contribution of an earlier equal demand, which it
        shares. RefusalError or DocumentError as `expand` raises them."""
        known = self._contributions.get(demand.key)
        if known is not None and known.contribution.demand is not demand and known.contribution.demand != demand:
            known = None
        if equal is not None:
            contribution = _sharing(demand, equal, known)
        else:
            contribution = _assigned(known, index, assignments) or Contribution(
                demand, expand(demand, index, assignments)
            )
        if known is not None and known.contribution is contribution:
            known.fleet = index.fleet
        else:
            self._contributions.keep(demand.key, _KnownContribution(contribution, index.fleet))
        return contribution

    def merged_release(self, first: Release, second: Release, paths: Sequence[str]) -> Release | None:
        """Both releases as one, as release_merge.merged_release returns it."""
        key = (id(first), id(second))  # of releases that the memo itself holds
        known = self._merged.get(key)
        if known is not None and known[2] == paths:
            return known[3]
        merged = merged_release(first, second, paths)
        self._merged.keep(key, (first, second, paths, merged))
        return merged

    # -- the answer -----------------------------------------------------------------------------------------------

    def bridges(self, state: AccumulatedState, index: Index) -> tuple[dict[End, str], dict[str, Release]]:
        """The key of every bridge, in the order of `state.bridged`, and the bridge by its key, as
        bridges.bridge_release makes it."""
        keys: dict[End, str] = {}
        bridges: dict[str, Release] = {}
        for end, contributions in state.bridged.items():
            known = self._bridges.get(end)
            if (
                known is None
                or known.contributions != contributions
                or known.pin != index.pins.get(known.key)
                or (known.fleet is not index.fleet and not _still_holds(known, end, index))
            ):
                release = bridge_release(end, contributions, state.topics, index)
                pin = index.pins.get(release.key)
                known = _KnownBridge(release, release.key, contributions, pin, index.fleet, _surroundings(end, index))
                self._bridges.keep(end, known)
            keys[end] = known.key
            bridges[known.key] = known.release
        return keys, bridges

    def written(
        self,
        releases: Mapping[str, Release],
        contributions: Mapping[str, Sequence[Contribution]],
        index: Index,
    ) -> dict[str, Release]:
        """Every release by its path, as accumulated_state.caused writes it."""
        written: dict[str, Release] = {}
        for key, release in releases.items():
            known = self._written.get(key)
            if (
                known is None
                or known.release is not release
                or known.contributions != contributions[key]
                or known.present is not index.present.get(known.path)
            ):
                present = index.present.get(release.path)
                with_causes = caused(release, contributions[key], present)
                known = _KnownRelease(with_causes, release, contributions[key], release.path, present)
                self._written.keep(key, known)
            written[known.path] = known.written
        return written

    def outcomes(self, state: AccumulatedState, bridges: Mapping[End, str]) -> dict[str, Met | Refused]:
        """The outcome of every demand: how it is met, by accumulated_state.met, or why it is refused."""
        outcomes: dict[str, Met | Refused] = {}
        for key, outcome in state.outcomes.items():
            if isinstance(outcome, Refused):
                outcomes[key] = outcome
                continue
            known = self._met.get(key)
            keys = [*map(bridges.__getitem__, outcome.ends)]
            if known is None or known[0] is not outcome or known[1] != keys:
                known = (outcome, keys, met(outcome, bridges))
                self._met.keep(key, known)
            outcomes[key] = known[2]
        return outcomes


def _sharing(demand: Demand, equal: Contribution, known: _KnownContribution | None) -> Contribution:
    """The contribution of a demand that shares the expansion of an equal one."""
    if known is not None:
        before = known.contribution
        if before.expansion is equal.expansion and before.shares == equal.demand.key:
            return before
    return Contribution(demand, equal.expansion, equal.demand.key)


def _assigned(known: _KnownContribution | None, index: Index, assignments: Assignments) -> Contribution | None:
    """The known contribution, its groups assigned, with the reasons of now; None, and nothing assigned, when it does
    not hold any more."""
    if known is None or known.contribution.shares or not _answered_alike(known, index):
        return None
    before = known.contribution
    if known.stays and known.fleet is index.fleet:
        mark = assignments.mark()
        if assignments.stay(known.stays, index.fleet):
            return before
        assignments.undo(mark)
    placements = _placements(before.expansion, index, assignments)
    if placements is None:
        return None
    pairs = zip(placements, before.expansion.groups, strict=True)
    if all(now is then.placement or now.reasons == then.placement.reasons for now, then in pairs):
        known.stays = _stays(before.expansion, placements, index.fleet)
        return before
    return Contribution(before.demand, before.expansion.with_placements(placements))


def _answered_alike(known: _KnownContribution, index: Index) -> bool:
    """Return whether everything that an expansion looked up has the same answer now."""
    expansion = known.contribution.expansion
    for name, kept in expansion.kept:
        if index.kept(expansion.demand, name) != kept:
            return False
    for key, pin in expansion.pins:
        if index.pins.get(key) != pin:
            return False
    try:
        return known.fleet is index.fleet or all(index.lookup(lookup) == answer for lookup, answer in expansion.lookups)
    except RefusalError:
        return False


def _placements(expansion: Expansion, index: Index, assignments: Assignments) -> list[Placement] | None:
    """The places of the groups of an expansion now; None, and nothing assigned, when it is elsewhere."""
    mark = assignments.mark()
    placements = []
    try:
        for group in expansion.groups:
            placement = assignments.assign(expansion.demand, group.group, group.names, index)
            if placement.agent != group.placement.agent:
                assignments.undo(mark)
                return None
            placements.append(placement)
    except RefusalError:
        assignments.undo(mark)
        return None
    return placements


def _stays(expansion: Expansion, placements: Sequence[Placement], fleet: Fleet) -> Sequence[Stay]:
    """The groups of an expansion, which were just placed, when all of them simply stay; else none."""
    pairs = zip(expansion.groups, placements, strict=True)
    stays = [stay_of(one.group, one.names, now, fleet) for one, now in pairs]
    return [stay for stay in stays if stay] if all(stays) else ()


def _homes_stay(before: Mapping[str, Release], now: Mapping[str, Release]) -> bool:
    """Return whether the same Nodes are homes for these releases: none that names a Node came, changed or went."""
    if before == now:
        return True
    changed = [releases.get(path) for path in different(before, now) for releases in (before, now)]
    return not any(placed_on(release, "node") for release in changed if release is not None)


def _surroundings(end: End, index: Index) -> tuple[Agent | None, Agent, frozenset[str]]:
    """The part of the fleet that a bridge depends on: its place, and the home and the platforms of its agent."""
    agent = index.fleet.at[end[1]]
    return agent, index.fleet.home(agent), index.platforms(agent.name)


def _still_holds(known: _KnownBridge, end: End, index: Index) -> bool:
    """Return whether a bridge is the same in another fleet."""
    if end[1] not in index.fleet.at or _surroundings(end, index) != known.surroundings:
        return False
    known.fleet = index.fleet
    return True
