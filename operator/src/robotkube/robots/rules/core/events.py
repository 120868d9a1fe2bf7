"""Events as their two edges: the begin and the end of a rule's holding for some agents, with their causes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

START, STOP = "start", "stop"
TASK_NAME_LENGTH_MAX = 63
NOTHING: Mapping[str, Any] = MappingProxyType({})


class Cause(NamedTuple):
    """A message that caused an edge: its topic, its stamp (ns since 1970), and the values that were compared."""

    topic: str
    stamp: int
    values: Mapping[str, Any]


@dataclass(frozen=True)
class Edge:
    """The begin (`start`) or end (`stop`) of an event of a rule for `agents`; both edges have the event's `id` and
    `trace`.

    `stamp`: the moment of the edge in the messages' own time, which the id is made of, so that a replay gives the same
    one; `time`: when it was noticed, on this machine's clock; ns since 1970. `detail`: numbers that were compared.
    """

    rule: str
    edge: str
    agents: tuple[str, ...]
    id: str
    trace: str
    time: int
    stamp: int
    distance_m: float | None = None
    causes: tuple[Cause, ...] = field(default=(), compare=False)
    detail: Mapping[str, float] = field(default_factory=lambda: NOTHING, compare=False)


def event_identity(rule: str, agents: Sequence[str], stamp: int) -> tuple[str, str]:
    """The id (16 hex) and trace (32 hex) of the event that began at `stamp`; the same for the same event."""
    digest = hashlib.sha256(f"{rule}|{','.join(agents)}|{stamp}".encode()).hexdigest()
    return digest[:16], digest[16:48]


def task_name(edge: Edge) -> str:
    """The name of the task that an event asks for: a valid object name, the same for the same event."""
    body = f"{edge.rule}-{'-'.join(edge.agents)}".lower()
    body = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in body)
    return f"{body[: TASK_NAME_LENGTH_MAX - 7].strip('-')}-{edge.id[:6]}"
