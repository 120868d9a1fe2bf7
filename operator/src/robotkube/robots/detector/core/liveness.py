"""The freshness of agents by their last message: fresh, stale (silent for a while) or expired (forgotten)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

FRESH, STALE, EXPIRED = "fresh", "stale", "expired"


@dataclass(frozen=True, slots=True)
class FreshnessBounds:
    """Seconds of silence after which an agent is stale, and after which it is expired; ValueError when the second is
    less than the first."""

    stale_seconds: float
    expire_seconds: float

    def __post_init__(self) -> None:
        if not 0 < self.stale_seconds <= self.expire_seconds:
            raise ValueError(f"stale after {self.stale_seconds} s, expired after {self.expire_seconds} s: swap them")


def freshness(last: Mapping[str, int], now: int, bounds: FreshnessBounds) -> Mapping[str, str]:
    """Agent -> FRESH, STALE or EXPIRED. `last`: agent -> time of its last message, ns of the same clock as `now`.

    Live, both are times of reception, since a robot's clock may be wrong; in a replay both are stamps.
    """
    stale, expired = int(bounds.stale_seconds * 1e9), int(bounds.expire_seconds * 1e9)
    return {
        agent: EXPIRED if now - last_at > expired else STALE if now - last_at > stale else FRESH
        for agent, last_at in last.items()
    }


def changes(before: Mapping[str, str], after: Mapping[str, str]) -> Mapping[str, str]:
    """Agent -> its new state, for the agents whose state is another; one that was not known counts as fresh before."""
    return {agent: state for agent, state in after.items() if before.get(agent, FRESH) != state}
