"""Messages that no rule saw, counted by topic and by the reason why."""

from __future__ import annotations

from collections.abc import Mapping

from robotkube.robots.ros.core.source_clocks import AHEAD, DISORDERED, LATE

__all__ = [
    "AHEAD",
    "DISORDERED",
    "LATE",
    "LOST",
    "MALFORMED",
    "NO_NUMBER",
    "REASONS",
    "STARTING",
    "UNREADABLE",
    "UnseenMessages",
]  # fmt: skip

MALFORMED, UNREADABLE, NO_NUMBER = "malformed", "unreadable", "no_number"
STARTING, LOST = "starting", "lost"
REASONS: Mapping[str, str] = {
    LATE: "the stamp is older than the buffer's window",
    AHEAD: "the stamp is too far ahead to be believed",
    DISORDERED: "the stamp is older than what rules had looked at already",
    MALFORMED: "the stamp cannot be read",
    UNREADABLE: "the fields that a rule reads cannot be read",
    NO_NUMBER: "a number that a rule compares is none (NaN), or a position is infinite",
    STARTING: "the detector had not been told yet which events last",
    LOST: "they were pushed out before they were received",
}
"""Reason -> what it means."""
TOPICS_MAX = 20_000
"""The most topics that are counted one by one; messages of others are in the totals only."""


class UnseenMessages:
    """Counters that only grow. The receiving thread writes them, others read them without a lock."""

    def __init__(self) -> None:
        self.totals = dict.fromkeys(REASONS, 0)
        self._by_topic: dict[str, dict[str, int]] = {}

    def count(self, topic: str, reason: str, messages: int = 1) -> None:
        """Count messages of a topic that no rule sees, for one of REASONS."""
        self.totals[reason] += messages
        counts = self._by_topic.get(topic)
        if counts is None:
            if len(self._by_topic) >= TOPICS_MAX:
                return
            counts = self._by_topic[topic] = dict.fromkeys(REASONS, 0)
        counts[reason] += messages

    def of(self, topic: str) -> Mapping[str, int]:
        """Reason -> messages of one topic."""
        return dict(self._by_topic.get(topic) or dict.fromkeys(REASONS, 0))

    def topics(self) -> Mapping[str, Mapping[str, int]]:
        """Topic -> reason -> messages, without what is 0."""
        known = self._by_topic.copy().items()
        return {topic: {reason: n for reason, n in counts.copy().items() if n} for topic, counts in known}


def unseen_text(counts: Mapping[str, int]) -> str:
    """The counts in words, without what is 0: `3 late (...), 1 ahead (...)`."""
    return ", ".join(f"{n} {reason} ({REASONS[reason]})" for reason, n in counts.items() if n)
