"""The messages that a process gave up, by topic, place and reason: number, first and last stamp (ns since 1970)."""

from __future__ import annotations

from collections.abc import Iterator

from robotkube.robots.ros.core.gaps import Gap

TOPICS_MAX = 1000
OTHERS = "others"


class Losses:
    """Gaps that still grow, and sums of all there were. Both hold at most TOPICS_MAX entries; what is beyond goes to
    the topic `others`."""

    def __init__(self) -> None:
        self._open: dict[tuple[str, str, str], Gap] = {}
        self._sums: dict[tuple[str, str, str], Gap] = {}

    def add(self, gap: Gap) -> None:
        """Add messages that were given up; gaps of one topic, place and reason are one until it is closed."""
        _join(self._open, gap)
        _join(self._sums, gap)

    def reopen(self, gap: Gap) -> None:
        """Open a closed gap again that has not been reported after all."""
        _join(self._open, gap)

    def close(self, topic: str) -> list[Gap]:
        """Close the gaps of a topic that goes on, and return them."""
        if not self._open:
            return []
        return [self._open.pop(key) for key in [key for key in self._open if key[0] == topic]]

    @property
    def open(self) -> tuple[Gap, ...]:
        """Every gap that still grows."""
        return tuple(self._open.values())

    @property
    def sums(self) -> Iterator[Gap]:
        """All that was given up, per topic, place and reason; counters may be read by any thread."""
        return iter(list(self._sums.values()))


def _join(known: dict[tuple[str, str, str], Gap], gap: Gap) -> None:
    key = (gap.topic, gap.where, gap.why)
    if key not in known and len(known) >= TOPICS_MAX:
        key = (OTHERS, gap.where, gap.why)
    known[key] = _joined(known.get(key), gap, key[0])


def _joined(known: Gap | None, gap: Gap, topic: str) -> Gap:
    if known is None:
        return Gap(topic, gap.where, gap.why, gap.count, gap.first, gap.last)
    count = None if known.count is None or gap.count is None else known.count + gap.count
    return Gap(topic, gap.where, gap.why, count, min(known.first, gap.first), max(known.last, gap.last))
