"""Subscriptions that were refused: when they are asked for again."""

from __future__ import annotations

from robotkube.robots.mqtt.core.refused_subscriptions import PAUSES_SECONDS, RefusedSubscriptions


def test_it_is_asked_for_after_longer_and_longer_pauses_until_it_is_granted() -> None:
    refused = RefusedSubscriptions()
    now = 100.0
    pauses = []
    for _ in range(6):
        refused.refused("a", now)
        before = now
        while refused.due(now) == []:
            now += 0.5
        pauses.append(now - before)
    assert pauses == [*PAUSES_SECONDS, PAUSES_SECONDS[-1], PAUSES_SECONDS[-1]]
    assert refused.granted("a")
    assert not refused.granted("a")
    assert refused.due(now + 60) == []


def test_it_is_not_asked_for_twice_before_the_answer() -> None:
    refused = RefusedSubscriptions()
    refused.refused("a", 0.0)
    assert refused.due(1.0) == ["a"]
    assert refused.due(1.1) == []


def test_what_nobody_wants_any_more_is_not_asked_for() -> None:
    refused = RefusedSubscriptions()
    for name in ("a", "b"):
        refused.refused(name, 0.0)
    refused.forget(["a", "c"])
    assert refused.due(1.0) == ["b"]
    refused.clear()
    assert refused.due(60.0) == []
