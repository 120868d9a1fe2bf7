"""A gap: messages of a topic that are known to be missing, where and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Interval = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Gap:
    """Messages of a topic that are not in storage. `where`: the part that lost them; `why`: in words.

    `count`: how many; None when nobody can know (a killed process). `first`, `last`: stamps they lie between, both
    included.
    """

    topic: str
    where: str
    why: str
    count: int | None
    first: int
    last: int

    def document(self) -> dict[str, Any]:
        """The gap as it is stored in the audit of its topic."""
        return {"where": self.where, "why": self.why, "count": self.count, "first": self.first, "last": self.last}

    def covers(self, stamp: int) -> bool:
        """Return whether the gap explains a missing message with this stamp."""
        return self.first <= stamp <= self.last


def read_gap(topic: str, values: Mapping[str, Any]) -> Gap:
    """A gap from its stored form."""
    return Gap(topic, values["where"], values["why"], values["count"], values["first"], values["last"])
