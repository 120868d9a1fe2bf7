"""Pairs whose stamps are too far apart to be compared: counted where a clock is wrong, and not where one is silent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from robotkube.robots.rules.core.messages import Member, pair

PAIRS_MAX = 1000
"""The most pairs that are told one by one; others are in the total only."""


@dataclass
class ApartPairs:
    """The pairs of one rule that were heard of at once, with stamps that are farther apart than `bound_ns`.

    `total`: comparisons that were left out; `by_pair`: pair -> how many, and by how many ns the stamps differed at
    last. One thread writes it, any may read it."""

    bound_ns: int
    total: int = 0
    by_pair: dict[Member, tuple[int, int]] = field(default_factory=dict)

    def note(self, agent: str, stamp: int, received: int, other: str, other_stamp: int, other_received: int) -> None:
        """Note that two agents were not compared; one that was last heard of long ago is silent, and counts not."""
        if abs(received - other_received) > self.bound_ns:
            return
        self.total += 1
        member = pair(agent, other)
        known = self.by_pair.get(member)
        if known is not None or len(self.by_pair) < PAIRS_MAX:
            self.by_pair[member] = (known[0] if known else 0) + 1, abs(stamp - other_stamp)

    def seconds(self) -> Mapping[Member, tuple[int, float]]:
        """Pair -> comparisons that were left out, and the seconds between its stamps at last."""
        return {member: (count, apart / 1e9) for member, (count, apart) in self.by_pair.copy().items()}
