"""Messages as rules read them, and the changes of conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from robotkube.robots.rules.core.events import NOTHING, Cause

RISE, KEEP, FALL = 1, 0, -1
"""The verdicts of a condition: it holds now, nothing new, it does not hold any more."""

NEVER = -(1 << 63)
"""The stamp before all others."""

Agents = tuple[str, ...]
Member = Agents
"""The agents that a condition is about: one, or two in alphabetical order."""


class NoNumberError(ValueError):
    """A number that is compared is none, as a sensor says that it knows nothing: the message changes nothing."""


class Message(NamedTuple):
    """One message as it came; `stamp` is the rules' time, `received` this machine's, ns since 1970."""

    topic: str
    type: str
    stamp: int
    received: int
    data: bytes


class MemberChange(NamedTuple):
    """A change of a condition: it begins (RISE) or ceases (FALL) to hold for a member at `stamp`."""

    member: Member
    verdict: int
    stamp: int
    received: int
    detail: Mapping[str, float] = NOTHING
    causes: tuple[Cause, ...] = ()


class MessageValues(NamedTuple):
    """A message of `agent` with the values of the fields that a condition reads, in its order."""

    topic: str
    agent: str
    stamp: int
    received: int
    values: Sequence[Any]
    type: str = ""
    data: bytes = b""


def pair(agent: str, other: str) -> Member:
    """Two agents as a member."""
    return (agent, other) if agent < other else (other, agent)
