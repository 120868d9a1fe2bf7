"""Every kind of rule as it is defined, said as plainly as it can be: what rules got, in order, -> edges.

What rules got is a list of steps: a message to evaluate, one that is only a sign of life, a source whose time begins
anew, and looks at the clock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import combinations
from math import inf
from typing import NamedTuple

from tests.stages.detector.rules import MS, SECOND

GRACE = 100 * MS
FOREVER = 1 << 62


class Step(NamedTuple):
    """One thing that rules got: `observe`, `overlook`, `restart` or `tick`; stamp and clock in ns, x in metres."""

    kind: str
    agent: str
    stamp: int
    clock: int
    x: float = 0.0


Edges = list[tuple[str, tuple[str, ...], int]]


def believed(steps: Iterable[Step]) -> list[Step]:
    """The steps as a rule of one source's order sees them: what is older than the last is a sign of life."""
    newest: dict[str, float] = {}
    plain = []
    for step in steps:
        if step.kind == "restart":
            newest[step.agent] = -inf
        behind = step.kind == "observe" and step.stamp < newest.get(step.agent, -inf)
        if step.kind == "observe" and not behind:
            newest[step.agent] = step.stamp
        plain.append(step._replace(kind="behind") if behind else step)
    return plain


def level(steps: Sequence[Step], start: float, stop: float) -> Edges:
    """x above `start`, until it is below `stop`."""
    active: set[str] = set()
    floor: dict[str, int] = {}
    edges: Edges = []
    for kind, agent, stamp, _, x in steps:
        if kind == "restart":
            floor[agent] = stamp
        if kind == "observe" and ((x > start and agent not in active) or (x < stop and agent in active)):
            active ^= {agent}
            edges.append(("start" if agent in active else "stop", (agent,), max(stamp, floor.get(agent, stamp))))
    return edges


def nearness(steps: Sequence[Step], start: float, stop: float, stale: int) -> Edges:
    """Each pair after each message of one of the two, by the last message of both."""
    active: set[tuple[str, ...]] = set()
    latest: dict[str, Step] = {}
    floor: dict[tuple[str, ...], int] = {}
    edges: Edges = []
    for step in steps:
        if step.kind == "restart":
            latest.pop(step.agent, None)
            floor |= {pair: step.stamp for pair in floor if step.agent in pair}
        if step.kind != "observe":
            continue
        latest[step.agent] = step
        for pair in combinations(sorted(latest), 2):
            one, other = (latest[agent] for agent in pair)
            if step.agent not in pair or abs(one.stamp - other.stamp) > stale:
                continue
            distance = abs(one.x - other.x)
            if (distance < start and pair not in active) or (distance > stop and pair in active):
                active ^= {pair}
                floor[pair] = max(one.stamp, other.stamp, floor.get(pair, -FOREVER))
                edges.append(("start" if pair in active else "stop", pair, floor[pair]))
    return edges


def absence(steps: Sequence[Step], bound: int) -> Edges:
    """From the last message plus `bound` to the next one; a sign of life moves the last one on, as the clock does."""
    last: dict[str, tuple[int, int]] = {}
    active: set[str] = set()
    floor: dict[str, int] = {}
    edges: Edges = []

    def edge(kind: str, agent: str, stamp: int) -> None:
        floor[agent] = max(stamp, floor.get(agent, -FOREVER))
        active.symmetric_difference_update({agent})
        edges.append((kind, (agent,), floor[agent]))

    for kind, agent, stamp, clock, _ in steps:
        if kind == "restart":
            last.pop(agent, None)
            floor[agent] = stamp
        elif kind in ("overlook", "behind") and agent in last and clock > last[agent][1]:
            last[agent] = last[agent][0] + clock - last[agent][1], clock
        elif kind == "observe":
            if agent in last and agent not in active and stamp - last[agent][0] > bound:
                edge("start", agent, last[agent][0] + bound)
            if agent in active:
                edge("stop", agent, stamp)
            last[agent] = stamp, clock
        elif kind == "tick":
            for other in sorted(set(last) - active):
                if last[other][1] + bound + GRACE <= clock:
                    edge("start", other, last[other][0] + bound)
    return edges


class _Counted:
    """The messages of one agent for `rate`."""

    def __init__(self, step: Step) -> None:
        self.first = self.last = self.said = step.stamp
        self.clock = step.clock
        self.stamps: list[int] = []


def rate(steps: Sequence[Step], low: float, high: float, window: int) -> Edges:
    """Below `low` Hz until above `high`, by the messages of each window, from the end of the first one on."""
    known: dict[str, _Counted] = {}
    held: set[str] = set()
    floor: dict[str, int] = {}
    edges: Edges = []

    def judge(agent: str, moment: int, told: int) -> None:
        counted = known[agent]
        hertz = sum(moment - window < stamp <= moment for stamp in counted.stamps) * SECOND / window
        begun = told >= counted.first + window
        if begun and ((hertz < low and agent not in held) or (hertz > high and agent in held)):
            held.symmetric_difference_update({agent})
            floor[agent] = max(told, floor.get(agent, -FOREVER))
            edges.append(("start" if agent in held else "stop", (agent,), floor[agent]))

    def leave(agent: str, until: int) -> None:
        counted = known[agent]
        for moment in sorted({s + window for s in counted.stamps if counted.said < s + window <= until}):
            judge(agent, moment, moment)
        counted.said = max(counted.said, until)

    for step in steps:
        agent = step.agent
        if step.kind == "restart":
            known.pop(agent, None)
            floor[agent] = step.stamp
        elif step.kind in ("overlook", "behind") and agent in known:
            counted = known[agent]
            counted.clock = max(counted.clock, step.clock)
            counted.stamps.append(step.stamp if step.kind == "behind" else counted.last)
        elif step.kind == "observe":
            counted = known.setdefault(agent, _Counted(step))
            leave(agent, step.stamp - 1)
            counted.stamps.append(step.stamp)
            counted.last = step.stamp
            counted.clock = step.clock
            counted.said = max(counted.said, step.stamp)
            judge(agent, counted.said, step.stamp)
        elif step.kind == "tick":
            for other, counted in known.items():
                if other not in held:
                    leave(other, counted.last + step.clock - counted.clock - GRACE)
    return edges


def both(held: Edges, absent: Edges, agents: Sequence[str]) -> Edges:
    """`held` lasts and `absent` does not, for each agent, at every moment at which one of them begins or ends."""
    edges: Edges = []
    for agent in agents:
        active = False
        for moment in sorted({stamp for _, members, stamp in (*held, *absent) if agent in members}):
            holds = _lasts(held, agent, moment) and not _lasts(absent, agent, moment)
            if holds != active:
                active = holds
                edges.append(("start" if holds else "stop", (agent,), moment))
    return edges


def _lasts(edges: Edges, agent: str, moment: int) -> bool:
    last = {agents: kind for kind, agents, stamp in edges if stamp <= moment and agent in agents}
    return "start" in last.values()


def ambiguous(edges: Edges, steps: Sequence[Step]) -> set[tuple[str, ...]]:
    """Those of whom the definitions do not say enough: who begins twice at one stamp (the second event begins 1 ns
    later), and whose time jumps while it is out of order, so that it begins anew twice."""
    starts = Counter((agents, stamp) for kind, agents, stamp in edges if kind == "start")
    twice = {agents for (agents, _), count in starts.items() if count > 1}
    began: dict[str, int] = {}
    torn: set[str] = set()
    for step in steps:
        if step.kind == "restart":
            began[step.agent] = step.stamp
        elif step.kind == "observe" and step.stamp < began.get(step.agent, step.stamp):
            torn.add(step.agent)
    return twice | {agents for _, agents, _ in edges if torn & set(agents)}


def longest_difference(one: Edges, other: Edges, agents: Sequence[str]) -> int:
    """The longest time without interruption for which one says that something lasts, and the other that it does not."""
    longest = 0
    for agent in agents:
        begun: int | None = None
        for moment in sorted({stamp for _, members, stamp in (*one, *other) if agent in members}):
            if _lasts(one, agent, moment) != _lasts(other, agent, moment):
                begun = moment if begun is None else begun
            elif begun is not None:
                longest = max(longest, moment - begun)
                begun = None
        if begun is not None:
            return FOREVER
    return longest
