"""Proximity among 1,000 agents at 10 Hz: processor time of the rules per second of poses, against comparing each pose
with all others.

Agents stand scattered over a town and move; the same poses go through the rule engine, decoding included, and through
the plain comparison. Both find the same pairs, or the numbers say nothing.
"""

from __future__ import annotations

import math
import random
import struct
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measuring.bags import NANOSECONDS, POSE_TYPE
from ci.errors import SetUpError
from robotkube.foundation.documents.core.reader import Reader
from robotkube.robots.ros.adapters.installed_definitions import definition
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.rules.core import START, read_rules
from robotkube.robots.rules.core.engine import RuleEngine
from robotkube.robots.rules.core.messages import Message

AGENTS, HERTZ, SECONDS, PLAIN_SECONDS = 1000, 10, 10, 1
TOWN_M, NEAR_M, APART_M, STEP_M = 10_000.0, 50.0, 60.0, 1.5
SEED = 7
POSITION_OFFSET = 20  # of x in a serialised PoseStamped with the frame `map`
BEGIN = 1_795_250_000 * NANOSECONDS


@dataclass(frozen=True)
class Proximity:
    """Processor seconds per second of poses, ours and of the plain comparison, and the pairs that came together."""

    core_fraction: float
    plain_core_fraction: float
    pairs: int


def poses(seconds: int) -> list[tuple[int, Message]]:
    """(agent, message) in the order of the stamps; a second has AGENTS x HERTZ of them."""
    chance = random.Random(SEED)  # noqa: S311 - reproducible, not secret
    places = [(chance.uniform(0, TOWN_M), chance.uniform(0, TOWN_M)) for _ in range(AGENTS)]
    directions = [chance.uniform(0, 2 * math.pi) for _ in range(AGENTS)]
    messages = []
    for step in range(seconds * HERTZ):
        for agent, ((x, y), direction) in enumerate(zip(places, directions, strict=True)):
            stamp = BEGIN + step * NANOSECONDS // HERTZ + agent * 50_000
            there = x + step * STEP_M * math.cos(direction), y + step * STEP_M * math.sin(direction)
            topic = f"/vehicles/agent_{agent}/pose"
            messages.append((agent, Message(topic, POSE_TYPE, stamp, stamp, _pose(stamp, *there))))
    return messages


def _pose(stamp: int, x: float, y: float) -> bytes:
    head = struct.pack("<4BiII4s", 0, 1, 0, 0, *divmod(stamp, NANOSECONDS), 4, b"map\0")
    return head + struct.pack("<7d", x, y, 0.0, 0.0, 0.0, 0.0, 1.0)


def engine() -> RuleEngine:
    """One rule over all agents."""
    pattern = "/vehicles/{agent}/pose"
    rule = {
        "name": "near",
        "kind": "proximity",
        "topic": pattern,
        "start_distance_m": NEAR_M,
        "stop_distance_m": APART_M,
    }
    layouts = Layouts(_definition)
    reader = Reader("the rule")
    rules = read_rules([reader.keys_of(rule, "rules[0]")], {pattern: POSE_TYPE}, layouts)
    if reader.problems:
        raise SetUpError("; ".join(reader.problems))
    return RuleEngine(rules, layouts, "cloud-0")


def _definition(type_name: str) -> str:
    text = definition(type_name, Path(sys.prefix) / "share")
    if not text:
        raise KeyError(type_name)
    return text


def measure() -> Proximity:
    """Both over the same first second; ours over all of them."""
    everything = poses(SECONDS)
    messages = [message for _, message in everything]
    ours = engine()
    began = time.process_time()
    edges = [edge for message in messages for edge in ours.observe(message)]
    fraction = (time.process_time() - began) / SECONDS
    first = everything[: PLAIN_SECONDS * HERTZ * AGENTS]
    began = time.process_time()
    plain = _plain(first)
    plain_fraction = (time.process_time() - began) / PLAIN_SECONDS
    until = first[-1][1].stamp
    pairs = {tuple(sorted(edge.agents)) for edge in edges if edge.edge == START and edge.stamp <= until}
    if pairs != plain:
        raise SetUpError(f"the rule found {len(pairs)} pairs, the plain comparison {len(plain)}")
    return Proximity(round(fraction, 3), round(plain_fraction, 3), len({edge.id for edge in edges}))


def _plain(entries: Sequence[tuple[int, Message]]) -> set[tuple[str, ...]]:
    """Every pair that was within NEAR_M once: each pose against the last one of every other agent."""
    read = struct.Struct("<2d").unpack_from
    last: dict[int, tuple[float, float]] = {}
    pairs: set[tuple[str, ...]] = set()
    for agent, message in entries:
        x, y = read(message.data, POSITION_OFFSET)
        for other, (there_x, there_y) in last.items():
            if other != agent and (x - there_x) ** 2 + (y - there_y) ** 2 < NEAR_M**2:
                pairs.add(tuple(sorted((f"agent-{agent}", f"agent-{other}"))))
        last[agent] = x, y
    return pairs


def main() -> None:
    """Print what was measured."""
    print(measure())


if __name__ == "__main__":
    main()
