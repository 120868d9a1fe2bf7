"""Combinations with parts that show themselves by silence: their edges have the stamps that the definition gives,
although silence is told late."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.robots.rules.core import START, STOP
from tests.stages.detector.rules import NUMBERS, POSES, RuleStage, seconds

HIGH: dict[str, Any] = {
    "name": "high", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_above": 5, "stop_below": 3,
    "silent": True,
}  # fmt: skip
LOST: dict[str, Any] = {"name": "lost", "kind": "absence", "topic": POSES, "seconds": 0.5, "silent": True}
AGENT = ("vehicle-00",)


def both(**parts: Any) -> RuleStage:
    return RuleStage(HIGH, LOST, {"name": "both", "kind": "combination", **parts})


def play(stage: RuleStage, *sent: tuple[float, Any], ticks: float = 0.02, end: float = 3) -> list[tuple[str, float]]:
    """Numbers and positions of one agent; the clock is looked at every `ticks` s."""
    edges = []
    now = 0.0
    for at, value in [*sent, (end, None)]:
        while now < at:
            edges += stage.tick(now)
            now = round(now + ticks, 3)
        if value is not None:
            edges += stage.send("vehicle-00", value, at)
    return [(edge, stamp) for edge, _, stamp in seconds(edges)]


TICKS = pytest.mark.parametrize("ticks", [0.01, 0.03, 10.0])


@TICKS
def test_nothing_begins_behind_an_absence_that_is_not_told_yet(ticks: float) -> None:
    """It did, and ended at the same stamp."""
    stage = both(all=["high", {"not": "lost"}])
    assert play(stage, (0, (0, 0, 0)), (0.55, 9), (0.8, 9), ticks=ticks) == []


@TICKS
def test_it_stops_when_the_absence_begins(ticks: float) -> None:
    """Not when the other part stops, 0.06 s later, before the absence is told."""
    stage = both(all=["high", {"not": "lost"}])
    edges = play(stage, (0, (0, 0, 0)), (0.1, 9), (0.56, 1), (0.9, 1), ticks=ticks)
    assert edges == [(START, 0.1), (STOP, 0.5)]


@TICKS
def test_what_an_absence_and_something_else_make_together_ends_with_the_last(ticks: float) -> None:
    stage = both(any=["high", {"not": "lost"}], agents=["vehicle-00"])
    edges = play(stage, (0, (0, 0, 0)), (0.1, 9), (0.56, 1), (0.9, 1), ticks=ticks)
    assert edges == [(START, 0.0), (STOP, 0.56)]


def test_a_message_within_the_bound_ends_the_doubt() -> None:
    """It was under way while the other part began."""
    stage = both(all=["high", {"not": "lost"}])
    stage.send("vehicle-00", (0, 0, 0), 0)
    edges = stage.send("vehicle-00", 9, 0.55)
    assert edges == []
    assert seconds(stage.send("vehicle-00", (0, 0, 0), 0.49, 0.58)) == [(START, AGENT, 0.55)]


@TICKS
def test_a_sustained_part_and_one_that_expires_are_waited_for(ticks: float) -> None:
    """The part that must not hold begins by time alone, at 1.2 s; the other one at 1.25 s, before that is told."""
    held = {**HIGH, "name": "held", "topic": POSES, "field": "pose.position.x", "sustained_seconds": 1.2}
    stage = RuleStage(HIGH, held, {"name": "both", "kind": "combination", "all": ["high", {"not": "held"}]})
    assert play(stage, (0, (9, 0, 0)), (1.25, 9), (1.5, 9), ticks=ticks) == []
    gone = {**HIGH, "name": "gone", "topic": POSES, "field": "pose.position.x", "expire_seconds": 1}
    stage = RuleStage(HIGH, gone, {"name": "both", "kind": "combination", "all": ["high", "gone"]})
    assert play(stage, (0, (9, 0, 0)), (1.05, 9), (1.5, 9), ticks=ticks) == []


@TICKS
def test_a_rate_is_waited_for(ticks: float) -> None:
    slow = {"name": "slow", "kind": "rate", "topic": POSES, "start_below_hz": 8, "stop_above_hz": 9,
            "window_seconds": 0.5, "silent": True}  # fmt: skip
    stage = RuleStage(HIGH, slow, {"name": "both", "kind": "combination", "all": ["high", {"not": "slow"}]})
    poses = [(at / 100, (0, 0, 0)) for at in range(0, 100, 10)]  # three are left in the window at 1.1 s
    assert play(stage, *poses, (1.15, 9), (1.6, 9), ticks=ticks) == []


@TICKS
def test_combinations_of_combinations_wait_too(ticks: float) -> None:
    rules = [
        HIGH, LOST, {"name": "calm", "kind": "combination", "not": "lost", "agents": [*AGENT], "silent": True},
        {"name": "both", "kind": "combination", "all": ["high", "calm"]},
    ]  # fmt: skip
    edges = play(RuleStage(*rules), (0, (0, 0, 0)), (0.1, 9), (0.56, 1), (0.9, 1), ticks=ticks)
    assert edges == [(START, 0.1), (STOP, 0.5)]


def test_without_doubt_nothing_waits() -> None:
    stage = both(all=["high", {"not": "lost"}])
    stage.send("vehicle-00", (0, 0, 0), 0)
    assert seconds(stage.send("vehicle-00", 9, 0.4)) == [(START, AGENT, 0.4)]


def test_doubt_about_clocks_that_differ_lasts_no_longer_than_a_silence_is_told_late() -> None:
    """The number's stamps are 5 s ahead of the poses'."""
    stage = both(all=["high", {"not": "lost"}])
    edges = [edge for step in range(8) for edge in stage.send("vehicle-00", (0, 0, 0), step / 10)]
    edges += stage.send("vehicle-00", 9, 5.7, 0.7)
    assert edges == []
    edges = [edge for step in range(8, 12) for edge in stage.send("vehicle-00", (0, 0, 0), step / 10)]
    assert seconds(edges) == [(START, AGENT, 5.7)]
