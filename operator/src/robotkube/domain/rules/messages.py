"""What comes to the rules and what they say about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from robotkube.domain.rules.edges import NOTHING, Cause

RISE, KEEP, FALL = 1, 0, -1
"""What a condition says: it holds now, nothing new, it does not hold any more."""

Agents = tuple[str, ...]
Member = Agents
"""Whom a condition is about: one agent, or two in alphabetical order."""


class Message(NamedTuple):
    """One message as it came; `stamp` is the rules' time, `received` this machine's, ns since 1970."""

    topic: str
    type: str
    stamp: int
    received: int
    data: bytes


class Finding(NamedTuple):
    """A member for whom a condition begins (RISE) or ceases (FALL) to hold at `stamp`."""

    member: Member
    verdict: int
    stamp: int
    received: int
    detail: Mapping[str, float] = NOTHING
    causes: tuple[Cause, ...] = ()


class Reading(NamedTuple):
    """A message of `agent` with the fields that a condition asked for, in its order."""

    topic: str
    agent: str
    stamp: int
    received: int
    values: Sequence[Any]
    type: str = ""
    data: bytes = b""


def pair(one: str, other: str) -> Member:
    """Two agents as a member."""
    return (one, other) if one < other else (other, one)
