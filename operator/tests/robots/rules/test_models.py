"""Rules against models that follow the definitions word by word, on random messages of fixed seeds."""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Sequence
from fractions import Fraction
from itertools import combinations
from typing import Any

import pytest

from robotkube.foundation.documents.core.reader import Reader
from robotkube.robots.rules.core import START, STOP, Edge, Message
from robotkube.robots.rules.core.specification.areas import Area, read_area
from tests.stages.detector.rules import MS, NOW, NUMBERS, POSE, POSES, SECOND, RuleStage, pose, seconds
from tests.stages.examples import EXAMPLES

CASES = [EXAMPLES, pytest.param(4000, marks=pytest.mark.thorough)]

BEGINS = (NOW, NOW, -100 * SECOND, -(2**31) * SECOND)
"""When sources' clocks begin: today, or before 1970, which a header can say."""
FAR = (1e13, -1e200, 1e200, sys.float_info.max, -sys.float_info.max)
"""Positions that nobody has, and a float can say."""

Seen = list[tuple[str, tuple[float, float], int]]


def shuffled_poses(chance: random.Random, agents: int, steps: int, width: float) -> Seen:
    """Positions, some of them very far out, with stamps that go on, sometimes by little, sometimes by more than poses
    are compared over."""

    def coordinate() -> float:
        return chance.choice(FAR) if chance.random() < 0.03 else chance.uniform(-width, width)

    stamp = 0
    messages = []
    for _ in range(steps):
        stamp += chance.choice((0, 1, 10, 100, 100, 300, 1500)) * MS
        name = f"vehicle-{chance.randrange(agents):02d}"
        messages.append((name, (coordinate(), coordinate()), stamp))
    return messages


def near_by_definition(seen: Seen, start: float, stop: float, stale: float) -> list[tuple[str, tuple[str, ...], int]]:
    """After each message every pair with its agent, from all positions so far."""
    active: set[tuple[str, ...]] = set()
    edges = []
    latest: dict[str, tuple[tuple[float, float], int]] = {}
    clock: dict[tuple[str, ...], int] = {}
    began: dict[tuple[str, ...], int] = {}
    for agent, position, stamp in seen:
        if agent in latest and latest[agent][1] > stamp:
            continue
        latest[agent] = position, stamp
        for pair in combinations(sorted(latest), 2):
            if agent not in pair:
                continue
            (one, at), (other, later) = latest[pair[0]], latest[pair[1]]
            if abs(at - later) > stale * SECOND:
                continue
            distance = math.dist(one, other)
            moment = max(at, later, clock.get(pair, 0))
            if pair not in active and distance < start and began.get(pair, -1) < moment:
                active.add(pair)
                clock[pair] = began[pair] = moment
                edges.append((START, pair, moment))
            elif pair in active and distance > stop:
                active.remove(pair)
                clock[pair] = moment
                edges.append((STOP, pair, moment))
    return edges


@pytest.mark.parametrize("cases", CASES)
def test_proximity_is_what_comparing_all_pairs_gives(cases: int) -> None:
    for seed in range(cases):
        chance = random.Random(seed)  # noqa: S311 - the same cases every time
        width = chance.choice((5.0, 20.0, 100.0))
        begin = chance.choice(BEGINS)
        document = {"name": "near", "kind": "proximity", "topic": POSES, "start_distance_m": 8, "stop_distance_m": 11}
        stage = RuleStage({**document, "expire_seconds": 3600})
        # distinct stamps per pair, so that a start and a stop never share one
        seen = [
            (agent, at, stamp + number)
            for number, (agent, at, stamp) in enumerate(shuffled_poses(chance, chance.choice((2, 3, 12)), 80, width))
        ]
        edges: list[Edge] = []
        for agent, (x, y), stamp in seen:
            name = f"/vehicles/{agent.replace('-', '_')}/pose"
            edges += stage.engine.observe(Message(name, POSE, begin + stamp, NOW + stamp, pose(x, y)))
        expected = near_by_definition(seen, 8, 11, 1.0)
        assert sorted((e.edge, e.agents, e.stamp - begin) for e in edges) == sorted(expected), seed
        assert all(math.isfinite(math.inf if e.distance_m is None else e.distance_m) for e in edges), seed


def events_by_definition(
    values: list[tuple[int, float]], timing: dict[str, float], start: float, stop: float
) -> list[tuple[str, int]]:
    """Thresholds by looking at every millisecond: since when it holds, and whether an event may begin."""
    sustained, interval, cooldown = (
        round(timing.get(key, 0) * 1000)
        for key in ("sustained_seconds", "minimum_interval_seconds", "cooldown_seconds")
    )
    at = dict(values)
    edges: list[tuple[str, int]] = []
    since: int | None = None
    active = False
    started = stopped = -(10**12)
    for now in range(values[0][0], values[-1][0] + 1):
        value = at.get(now)
        if value is not None and value > start and since is None:
            since = now
        if value is not None and value < stop and since is not None:
            since = None
            if active:
                active = False
                stopped = now
                edges.append((STOP, now))
        ready = since is not None and now >= max(since + sustained, started + interval, stopped + cooldown)
        if ready and not active:
            active = True
            started = now
            edges.append((START, now))
    return edges


@pytest.mark.parametrize("cases", CASES)
def test_thresholds_with_timing_are_what_the_definition_gives(cases: int) -> None:
    for seed in range(cases):
        chance = random.Random(seed)  # noqa: S311 - the same cases every time
        timing = {
            key: chance.choice((0, 0.05, 0.2, 0.5))
            for key in ("sustained_seconds", "minimum_interval_seconds", "cooldown_seconds")
        }
        stage = RuleStage(
            {"name": "high", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_above": 5, "stop_below": 3}
            | timing,
            begin=chance.choice(BEGINS),
        )
        stamps = sorted(chance.sample(range(1, 3000), 60))
        values = [(stamp, chance.choice((1.0, 2.9, 3.5, 4.9, 6.0, 7.0, float("nan")))) for stamp in stamps]
        values.append((3500, float("nan")))
        edges = [edge for stamp, value in values for edge in stage.send("vehicle-00", value, stamp / 1000)]
        expected = [(edge, round(stamp / 1000, 3)) for edge, stamp in events_by_definition(values, timing, 5, 3)]
        assert [(edge, at) for edge, _, at in seconds(edges, stage.begin)] == expected, (seed, timing)


def test_the_time_gives_the_same_as_the_next_message() -> None:
    """Whether a start shows itself by a tick or by a later message: same stamp, same id."""
    document = {
        "name": "high", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_above": 5, "stop_below": 3,
        "sustained_seconds": 1,
    }  # fmt: skip
    ticked, sent = RuleStage(document), RuleStage(document)
    assert ticked.send("vehicle-00", 6, 0) == sent.send("vehicle-00", 6, 0) == []
    assert ticked.tick(1.05) == [], "a message of 0.99 s may still be under way"
    [edge] = ticked.tick(1.2)
    [same] = sent.send("vehicle-00", 6, 1.4)
    assert (edge.id, edge.stamp, edge.trace) == (same.id, same.stamp, same.trace)
    assert edge.stamp == NOW + SECOND


@pytest.mark.parametrize("cases", CASES)
def test_absence_is_every_gap_longer_than_the_bound(cases: int) -> None:
    for seed in range(cases):
        chance = random.Random(seed)  # noqa: S311 - the same cases every time
        begin = chance.choice(BEGINS)
        stage = RuleStage({"name": "lost", "kind": "absence", "topic": NUMBERS, "seconds": 0.5}, begin=begin)
        stamps = sorted(chance.sample(range(0, 9000), chance.randint(2, 40)))
        edges: list[Edge] = []
        now = 0
        for stamp in stamps:
            if chance.random() < 0.5:  # the clock is looked at now and then, or not at all
                for moment in range(now, stamp, 130):
                    edges += stage.tick(moment / 1000)
                now = stamp
            edges += stage.send("vehicle-00", 1, stamp / 1000)
        edges += stage.tick((stamps[-1] + 700) / 1000)
        expected = [
            edge
            for earlier, later in zip(stamps, [*stamps[1:], None], strict=True)
            if later is None or later - earlier > 500
            for edge in [(START, earlier + 500), *([(STOP, later)] if later is not None else [])]
        ]
        assert [(edge, round(at * 1000)) for edge, _, at in seconds(edges, begin)] == expected, seed


def rates_by_definition(stamps: list[int], end: int, low: float, high: float, window: int) -> list[tuple[str, int]]:
    """Too slow: the messages of the last window, counted every millisecond."""
    edges = []
    active = False
    for now in range(stamps[0] + window, end + 1):
        rate = sum(now - window < stamp <= now for stamp in stamps) / window * 1000
        if not active and rate < low:
            active = True
            edges.append((START, now))
        elif active and rate > high:
            active = False
            edges.append((STOP, now))
    return edges


@pytest.mark.parametrize("cases", [EXAMPLES, pytest.param(1000, marks=pytest.mark.thorough)])
def test_rates_are_what_counting_gives(cases: int) -> None:
    for seed in range(cases):
        chance = random.Random(seed)  # noqa: S311 - the same cases every time
        stage = RuleStage(
            {
                "name": "slow",
                "kind": "rate",
                "topic": NUMBERS,
                "start_below_hz": 8,
                "stop_above_hz": 12,
                "window_seconds": 0.5,
            },
            begin=chance.choice(BEGINS),
        )
        stamps = []
        stamp = 0
        for _ in range(60):
            stamp += chance.choice((20, 50, 50, 90, 100, 200, 400))
            stamps.append(stamp)
        edges = [edge for stamp in stamps for edge in stage.send("vehicle-00", 1, stamp / 1000)]
        edges += stage.tick((stamps[-1] + 1100) / 1000)
        expected = rates_by_definition(stamps, stamps[-1] + 1000, 8, 12, 500)
        assert [(edge, round(at * 1000)) for edge, _, at in seconds(edges, stage.begin)] == expected, seed


def problems_of_area(*rings: list[list[float]]) -> list[str]:
    reader = Reader("area")
    read_area(reader.keys_of({"type": "Polygon", "coordinates": list(rings)}, "area"))
    return reader.problems


def inside_by_winding(ring: list[list[float]], x: int, y: int) -> bool | None:
    """By another way: how often whole-number rings wind around a point; None on the ring."""
    turns = 0
    for (x1, y1), (x2, y2) in zip(ring, ring[1:] + ring[:1], strict=True):
        side = (x2 - x1) * (y - y1) - (x - x1) * (y2 - y1)
        if side == 0 and min(x1, x2) <= x <= max(x1, x2) and min(y1, y2) <= y <= max(y1, y2):
            return None
        if y1 <= y < y2 and side > 0:
            turns += 1
        if y2 <= y < y1 and side < 0:
            turns -= 1
    return turns % 2 != 0


@pytest.mark.parametrize("cases", CASES)
def test_areas_hold_what_winding_says(cases: int) -> None:
    for seed in range(cases):
        chance = random.Random(seed)  # noqa: S311 - the same cases every time
        outer = [[chance.randint(-9, 9), chance.randint(-9, 9)] for _ in range(chance.randint(3, 8))]
        hole = [[-3, -3], [3, -3], [3, 3], [-3, 3]]
        flat = len({(x * 3 + y * 7, x, y) for x, y in outer}) < 3
        crossed = [(b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]) for a, b, c in [outer[:3]]]
        if flat or not crossed[0]:
            continue
        area = Area([tuple(tuple((float(x), float(y)) for x, y in ring) for ring in (outer, hole))])
        for _ in range(40):
            x, y = chance.randint(-10, 10), chance.randint(-10, 10)
            out, into = inside_by_winding(outer, x, y), inside_by_winding(hole, x, y)
            assert area.contains(x, y) == (out is not False and into is not True), (seed, x, y)


def crosses_by_every_pair(ring: list[list[float]]) -> bool:
    """Whole numbers: every edge with every other, by the parameters at which their lines meet."""
    edges = list(zip(ring, ring[1:] + ring[:1], strict=True))
    for (a, b), (c, d) in combinations(edges, 2):
        across = (b[0] - a[0]) * (d[1] - c[1]) - (b[1] - a[1]) * (d[0] - c[0])
        if across:
            one = Fraction(int((c[0] - a[0]) * (d[1] - c[1]) - (c[1] - a[1]) * (d[0] - c[0])), int(across))
            other = Fraction(int((c[0] - a[0]) * (b[1] - a[1]) - (c[1] - a[1]) * (b[0] - a[0])), int(across))
            if 0 < one < 1 and 0 < other < 1:
                return True
    return False


@pytest.mark.parametrize("cases", CASES)
def test_rings_that_cross_themselves_are_refused_and_no_others(cases: int) -> None:
    crossing = 0
    for seed in range(cases):
        chance = random.Random(seed)  # noqa: S311 - the same cases every time
        ring = [[chance.randint(-9, 9), chance.randint(-9, 9)] for _ in range(chance.randint(4, 7))]
        if ring[0] == ring[-1] or "enclose something" in str(problems := problems_of_area(ring)):
            continue
        crossing += crosses_by_every_pair(ring)
        assert ("cross themselves" in str(problems)) == crosses_by_every_pair(ring), (seed, ring, problems)
    assert 0 < crossing < cases
    wide = [[math.cos(n / 500 * math.pi) * 1e6, math.sin(n / 500 * math.pi) * 1e6] for n in range(1000)]
    assert not problems_of_area(wide)
    assert not problems_of_area([[0, 0], [0.1, 0.1], [0.2, 0.2], [0.3, 0.3], [0.7, 0.7], [0, 1]]), "digits of rounding"


def level(name: str, above: float) -> dict[str, Any]:
    """A rule that says nothing itself: the number is above a bound."""
    return {
        "name": name, "kind": "threshold", "topic": NUMBERS, "field": "data", "silent": True,
        "start_above": above, "stop_below": above,
    }  # fmt: skip


def chains_by_definition(starts: list[tuple[int, str]], parts: list[str], within: int) -> list[int]:
    """The stamps at which a sequence is complete: every way to choose one start per part is tried."""

    def complete(end: int, index: int, last: int) -> bool:
        if index < 0:
            return last >= end - within
        return any(
            complete(end, index - 1, at) for at, name in starts if name == parts[index] and end - within <= at < last
        )

    return [at for at, name in starts if name == parts[-1] and complete(at, len(parts) - 2, at)]


@pytest.mark.parametrize("cases", CASES)
def test_sequences_are_what_trying_every_choice_gives(cases: int) -> None:
    for seed in range(cases):
        chance = random.Random(seed)  # noqa: S311 - the same cases every time
        parts = [chance.choice("abc") for _ in range(chance.randint(2, 4))]
        stage = RuleStage(
            level("a", 1), level("b", 2), level("c", 3),
            {"name": "chain", "kind": "combination", "sequence": parts, "within_seconds": 2},
        )  # fmt: skip
        starts = []
        stops = []
        before = 0.0
        for step in range(40):
            at = step * 0.7 + chance.choice((0, 0.25))
            value = chance.choice((0.5, 1.5, 2.5, 3.5))
            starts += [(round(at * 1000), n) for n, low in zip("abc", (1, 2, 3), strict=True) if before < low < value]
            before = value
            stops += stage.send("vehicle-00", value, at)
        expected = chains_by_definition(starts, parts, 2000)
        got = [round(at * 1000) for edge, _, at in seconds(stops) if edge == START]
        assert got == expected, (seed, parts)


Part = str | dict[str, str]
Layer = tuple[str, str, list[Part]]


def layers(chance: random.Random) -> list[Layer]:
    """Combinations of levels and of combinations before them: name, mode and parts, some of them negated."""
    known = list("abc")
    made = []
    for number in range(chance.randint(2, 6)):
        mode = chance.choice(("all", "any", "not"))
        names = chance.sample(known, 1 if mode == "not" else chance.randint(2, 3))
        parts: list[Part] = [{"not": name} if mode != "not" and chance.random() < 0.5 else name for name in names]
        made.append((f"k{number}", mode, parts))
        known.append(f"k{number}")
    return made


def truth(made: Sequence[Layer], value: float) -> dict[str, bool]:
    """Which of them hold for a number, from the first to the last."""
    holds = {name: value > low for name, low in zip("abc", (1, 2, 3), strict=True)}
    for name, mode, parts in made:
        each = [not holds[part["not"]] if isinstance(part, dict) else holds[part] for part in parts]
        holds[name] = all(each) if mode == "all" else any(each) if mode == "any" else not each[0]
    return holds


@pytest.mark.parametrize("cases", CASES)
def test_combinations_of_combinations_are_what_their_formulas_say(cases: int) -> None:
    for seed in range(cases):
        chance = random.Random(seed)  # noqa: S311 - the same cases every time
        made = layers(chance)
        documents = [
            {"name": name, "kind": "combination", "agents": ["vehicle-00"], mode: parts[0] if mode == "not" else parts}
            for name, mode, parts in made
        ]
        chance.shuffle(documents)
        stage = RuleStage(level("a", 1), level("b", 2), level("c", 3), *documents)
        edges = stage.tick(0)
        before = dict.fromkeys([name for name, _, _ in made], False)
        expected = []
        for at, value in enumerate((0.0, *(chance.choice((0.5, 1.5, 2.5, 3.5)) for _ in range(20)))):
            edges += stage.send("vehicle-00", value, at) if at else []
            now = truth(made, value)
            expected += [(at, name, START if now[name] else STOP) for name in before if now[name] != before[name]]
            before = {name: now[name] for name in before}
        got = sorted((round((edge.stamp - NOW) / SECOND), edge.rule, edge.edge) for edge in edges)
        assert got == sorted(expected), (seed, made)
