"""Demands -> the releases that should exist, with reasons; a demand that cannot be met is refused and leaves no trace.

Services become releases; services with links of kind ros share a node; links of kind mqtt become topics of the bridge
release at both ends, as the union over all demands, so that no message crosses twice. Demands are met in the order in
which they are given: what comes first has its seat first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from robotkube.domain.drafts import Draft, Drafter, choices_of
from robotkube.domain.errors import DocumentError, RefusalError
from robotkube.domain.scenes import Scene
from robotkube.domain.seating import Seating
from robotkube.domain.totals import Entry, Known, SpoiledError, Total
from robotkube.domain.values_schemas import Validate
from robotkube.domain.worlds import Demand, Desired, Met, Refused, World

__all__ = ["Composer", "Demand", "Desired", "Met", "Refused", "Validate", "World", "compose"]

DRAFTS_KEPT_MAX = 4096
POINTS_APART = 64  # demands between two points from which composing can go on
POINTS_BETWEEN_MAX = 3


@dataclass
class _Run:
    """One pass over the demands, and the totals after some of them, by their number."""

    scene: Scene
    watched: frozenset[str]
    demands: list[Demand]
    points: dict[int, Total] = field(default_factory=dict)

    def common(self, demands: Sequence[Demand]) -> int:
        """How many demands at the beginning are the same."""
        for number, (mine, other) in enumerate(zip(self.demands, demands, strict=False)):
            if mine is not other and mine != other:
                return number
        return min(len(self.demands), len(demands))

    def note(self, number: int, total: Total) -> None:
        """Remember the total as it is after `number` demands; of points between the regular ones only the last few."""
        if number and number not in self.points:
            self.points[number] = total.copy(self.scene)
        between = sorted(point for point in self.points if point % POINTS_APART)
        for point in between[:-POINTS_BETWEEN_MAX]:
            del self.points[point]


class Composer:
    """Composes again and again; keeps what it drafted as long as its inputs stay, and gives the same answer as from
    scratch. Not for several threads at once."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._drafts: dict[str, Draft] = {}
        self._known = Known()
        self._last: _Run | None = None
        self._seen: frozenset[str] = frozenset()

    def compose(self, demands: Iterable[Demand], world: World) -> Desired:
        """Meet the demands in this order. Desired has one outcome for each; nothing is raised."""
        asked = list(demands)
        scene = Scene(world, self._scene)
        if self._scene is None or scene.selector is not self._scene.selector:
            self._drafts, self._known, self._last = {}, Known(), None
        self._scene = scene
        spoilers: dict[str, Refused] = {}
        for _ in range(len(asked)):  # a bridge that cannot be: each time at least one demand more is left out
            try:
                return self._run(asked, spoilers)
            except SpoiledError as error:
                spoilers.update(dict.fromkeys(error.demands, error.refused))
                self._last = None
        return self._run(asked, spoilers)

    def _run(self, demands: list[Demand], spoilers: Mapping[str, Refused]) -> Desired:
        assert self._scene is not None
        watched = frozenset(word for demand in demands for word in demand.keeps_away)
        run, done = _Run(self._scene, watched, demands), 0
        total, last = Total(self._scene, Seating(self._scene, watched), self._known), self._last
        if last is not None and not spoilers and last.watched == watched and last.scene.same(self._scene):
            common = last.common(demands)
            run.points = {number: point for number, point in last.points.items() if number <= common}
            done = max(run.points, default=0)
            total = run.points[done].copy(self._scene) if done else total
        seen, self._seen = self._seen, frozenset(demand.key for demand in demands)
        news = next((n for n, demand in enumerate(demands) if demand.key not in seen), len(demands))
        for number, demand in enumerate(demands[done:], done):
            if number == news:
                total.settle()  # the next time may well begin here
            if number == news or number % POINTS_APART == 0:
                run.note(number, total)
            total.outcomes[demand.key] = spoilers.get(demand.key) or self._meet(demand, total)
        total.settle()
        run.note(len(demands), total)
        self._last = None if spoilers else run
        return total.desired()

    def _meet(self, demand: Demand, total: Total) -> Entry | Refused:
        equal, mark = total.first.get(demand.shared_key), total.seating.mark()
        try:
            draft = equal.draft if equal else self._draft(demand, total.scene, total.seating)
            entry = Entry(demand, draft, equal.demand.key if equal else "")
            total.merge(entry)
        except RefusalError as error:
            total.seating.undo(mark)
            return Refused(error.reason, error.message)
        except DocumentError as error:
            total.seating.undo(mark)
            return Refused("CompositionFailed", str(error))
        if not equal:
            total.first[demand.shared_key] = entry
        return entry

    def _draft(self, demand: Demand, scene: Scene, seating: Seating) -> Draft:
        """The known draft when it still holds, seated; else a new one."""
        draft, known = None, self._drafts.get(demand.key)
        if known is not None and (known.demand is demand or known.demand == demand):
            draft = _seated(known, demand, scene, seating)
        if draft is None:
            draft = Drafter(demand, scene, seating).draft()
        self._drafts.pop(demand.key, None)
        self._drafts[demand.key] = draft
        if len(self._drafts) > DRAFTS_KEPT_MAX:
            self._drafts.pop(next(iter(self._drafts)))
        return draft


def _seated(draft: Draft, demand: Demand, scene: Scene, seating: Seating) -> Draft | None:
    """The draft in its seats, with the reasons of now; None, and nobody seated, when it no longer holds."""
    mark = seating.mark()
    try:
        if draft.fleet is not scene.fleet and any(scene.answer(q) != answer for q, answer in draft.questions):
            return None
        if any(scene.pins.get(key) != pin for key, pin in draft.pins):
            return None
        draft.fleet = scene.fleet
        steps = [replace(s, placement=seating.seat(demand, s.group, s.names, s.needs, scene)) for s in draft.steps]
    except RefusalError:
        seating.undo(mark)
        return None
    if any(now.placement.agent != then.placement.agent for now, then in zip(steps, draft.steps, strict=True)):
        seating.undo(mark)
        return None
    if all(now.placement.reasons == then.placement.reasons for now, then in zip(steps, draft.steps, strict=True)):
        return draft
    return replace(draft, steps=steps, choices=choices_of(draft.words, steps))


def compose(demands: Iterable[Demand], world: World) -> Desired:
    """Meet the demands in this order, from scratch."""
    return Composer().compose(demands, world)
