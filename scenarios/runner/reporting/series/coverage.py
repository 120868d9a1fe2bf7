"""Recordings: the window of each, from when to when it holds messages of a topic, and where messages are missing.

A gap is where two neighbouring stamps lie farther apart than GAP_PERIODS periods of the topic; inside the window its
ends count as stamps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from scenarios.definition import Scenario, cloud_topic
from scenarios.runner.inputs import NANOSECONDS, RunInputs
from scenarios.runner.judging.encounters import Encounter

GAP_PERIODS = 1.5
GAPS_MAX = 50  # the longest ones of a topic


def recordings(scenario: Scenario, inputs: RunInputs, met: Sequence[Encounter]) -> list[dict[str, Any]]:
    """One entry per encounter, times in s since the start, by source stamps."""
    return [
        {
            "event": one.start.id,
            "window": [_since(inputs, edge) for edge in one.window] if one.window else None,
            "lost": one.lost,
            "topics": [_topic(scenario, inputs, one, agent, topic) for agent, topic in _topics(one)],
        }
        for one in met
    ]


def _topics(one: Encounter) -> Iterator[tuple[str, str]]:
    for topic in one.topics:
        yield one.agents[one.topics.index(topic) % len(one.agents)], topic


def _topic(scenario: Scenario, inputs: RunInputs, one: Encounter, agent: str, topic: str) -> dict[str, Any]:
    clouds = topic == cloud_topic(agent)
    hertz = scenario.parameters.point_cloud_hz if clouds else scenario.parameters.pose_hz
    stamps = sorted({message.stamp for message in one.readable if message.topic == topic})
    gaps = list(_gaps(_with_window(stamps, one.window), int(GAP_PERIODS * NANOSECONDS / hertz)))
    longest = sorted(sorted(gaps, key=lambda gap: gap[0] - gap[1])[:GAPS_MAX])
    return {
        "agent": agent,
        "what": "point clouds" if clouds else "poses",
        "messages": len(stamps),
        "first": _since(inputs, stamps[0]) if stamps else None,
        "last": _since(inputs, stamps[-1]) if stamps else None,
        "gaps": [[_since(inputs, begin), _since(inputs, end)] for begin, end in longest],
        "gaps_total": len(gaps),
    }


def _with_window(stamps: Sequence[int], window: tuple[int, int] | None) -> list[int]:
    """The stamps, with those ends of the window that they do not reach."""
    if window is None or window[0] >= window[1]:
        return list(stamps)
    if not stamps:
        return list(window)
    begin, end = window
    return [begin] * (begin < stamps[0]) + list(stamps) + [end] * (end > stamps[-1])


def _gaps(stamps: Sequence[int], longest: int) -> Iterator[tuple[int, int]]:
    return ((begin, end) for begin, end in pairwise(stamps) if end - begin > longest)


def _since(inputs: RunInputs, moment: int) -> float:
    return (moment - inputs.started) / NANOSECONDS
