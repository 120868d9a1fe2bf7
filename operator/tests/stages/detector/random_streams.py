"""Random streams of poses: regular ones, and what goes wrong with their stamps and on their way."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hypothesis import strategies as st

from tests.stages.detector.rules import MS, NOW, SECOND
from tests.stages.detector.streams import Sent

AGENTS = ("vehicle-00", "vehicle-01", "vehicle-02")
STEPS = 80
PERIOD = 100 * MS
BEGIN = 200 * SECOND
LATENCY_MAX = 20
"""ms that a message takes at most when nothing is wrong: less than its period, and than silence is told late."""


class Disturbance(NamedTuple):
    """Something that goes wrong: what, to whom, from which step on, for how many of them, by how many ms."""

    kind: str
    agent: str
    step: int
    steps: int
    amount: int


@dataclass
class _Message:
    """A message on its way; `at`: when it is sent."""

    stamp: int
    at: int
    received: int
    x: float
    sent: bool = True


def _jump(messages: Sequence[_Message], _: Sequence[_Message], amount: int, __: random.Random) -> None:
    for message in messages:
        message.stamp += amount * MS


def _far(_: Sequence[_Message], some: Sequence[_Message], amount: int, __: random.Random) -> None:
    some[0].stamp += amount * 40 * MS


def _silence(_: Sequence[_Message], some: Sequence[_Message], __: int, ___: random.Random) -> None:
    for message in some:
        message.sent = False


def _disorder(_: Sequence[_Message], some: Sequence[_Message], amount: int, chance: random.Random) -> None:
    for message in some:
        message.received += chance.randrange(abs(amount) // 3 + 1) * MS


DISTURBANCES: Mapping[str, Callable[[Sequence[_Message], Sequence[_Message], int, random.Random], None]] = {
    "jump": _jump, "far": _far, "silence": _silence, "disorder": _disorder,
}  # fmt: skip
KINDS = (*DISTURBANCES, "skew", "duplicate")
_amounts = st.one_of(st.integers(-3_000, 3_000), st.sampled_from([-60_000, -9_000, -5_000, 5_000, 9_000, 60_000]))
_steps = st.integers(0, STEPS - 1)
_anything = st.builds(
    Disturbance, st.sampled_from(KINDS), st.sampled_from(AGENTS), _steps, st.integers(1, 50), _amounts
)
_silences = st.builds(Disturbance, st.just("silence"), st.sampled_from(AGENTS), _steps, st.integers(4, 12), st.just(0))
disturbances = st.one_of(st.lists(_anything, max_size=4), st.lists(_silences, min_size=2, max_size=9))
seeds = st.integers(0, 1 << 16)
epochs = st.sampled_from([0, 0, -NOW - 3600 * SECOND])
"""How much earlier than today the sources' clocks are: not at all, or before 1970."""


def stream(seed: int, wrong: Sequence[Disturbance], epoch: int = 0) -> list[Sent]:
    """Three agents at 10 Hz on a line, with these disturbances; no two messages have one stamp but duplicates. `epoch`
    is added to all stamps."""
    chance = random.Random(seed)  # noqa: S311 - the same cases every time
    sent: list[Sent] = []
    for index, agent in enumerate(AGENTS):
        messages = []
        x = chance.uniform(-40, 40)
        for step in range(STEPS):
            at = BEGIN + step * PERIOD + index * 7 * MS
            x += chance.uniform(-12, 12)
            messages.append(_Message(at, at, at + chance.randrange(1, LATENCY_MAX) * MS, x))
        copies = []
        for disturbance in (each for each in wrong if each.agent == agent):
            first = 0 if disturbance.kind == "skew" else disturbance.step
            some = messages[first : first + disturbance.steps]
            if disturbance.kind == "duplicate":
                copies += some
            else:
                change = DISTURBANCES["jump" if disturbance.kind == "skew" else disturbance.kind]
                change(messages[first:], some, disturbance.amount, chance)
        for serial, message in enumerate(messages):
            message.stamp += epoch + serial * 3 + index
        sent += [Sent(agent, m.stamp, m.received, m.x) for m in messages if m.sent]
        sent += [Sent(agent, m.stamp, m.received + 300 * MS, m.x) for m in copies if m.sent]
    return sorted(sent, key=lambda message: message.received)
