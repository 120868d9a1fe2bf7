"""The condition Removed of an Inspection: what became of the strangers that it names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.removal.core.targets import LEFT, NOT_BY_API

REMOVED = "Removed"
TRUE, FALSE, UNKNOWN = "True", "False", "Unknown"
NOTHING_NAMED, NOT_SEEN = "NothingNamed", "NotSeen"
REFUSED, TOO_MANY, COMES_AGAIN, REMOVING, RESTORING = "Refused", "TooMany", "ComesAgain", "Removing", "Restoring"
ORDER = (REFUSED, NOT_BY_API, TOO_MANY, COMES_AGAIN, *(one for one in LEFT if one != NOT_BY_API), REMOVING, RESTORING)
"""Reasons of a condition, the one first that most needs a person."""
WARNINGS = (REFUSED, NOT_BY_API, TOO_MANY, COMES_AGAIN)
SENTENCES_MAX = 5
MESSAGE_CHARACTERS_MAX = 1000


@dataclass(frozen=True)
class Outcome:
    """What became of one stranger: a reason of ORDER and a sentence. Sentences say nothing that changes by the second:
    each change is written."""

    reason: str
    sentence: str


@dataclass(frozen=True)
class Condition:
    """The condition without its time."""

    status: str
    reason: str
    message: str

    @property
    def warns(self) -> bool:
        """Return whether a person has to do something."""
        return self.reason in WARNINGS

    def is_said(self, before: Mapping[str, Any]) -> bool:
        """Return whether the condition before says the same."""
        return (before.get("status"), before.get("reason"), before.get("message")) == (
            self.status,
            self.reason,
            self.message,
        )

    def document(self, before: Mapping[str, Any], now: str) -> dict[str, str]:
        """The condition as the API has it, at time `now` (RFC 3339)."""
        same = before.get("status") == self.status
        changed = str(before.get("lastTransitionTime", now)) if same else now
        words = {"status": self.status, "reason": self.reason, "message": self.message}
        return {"type": REMOVED, **words, "lastTransitionTime": changed}


def condition_of(outcomes: Sequence[Outcome], believed: bool) -> Condition:
    """The condition of an Inspection whose strangers had these outcomes; `believed`: it says what it saw a moment
    ago."""
    if not believed:
        return Condition(UNKNOWN, NOT_SEEN, "nothing was seen lately, so nothing is removed")
    if not outcomes:
        return Condition(TRUE, NOTHING_NAMED, "no stranger is named")
    ordered = sorted(set(outcomes), key=lambda one: (ORDER.index(one.reason), one.sentence))
    more = len(ordered) - SENTENCES_MAX
    words = "; ".join([*(one.sentence for one in ordered[:SENTENCES_MAX]), *([f"and {more} more"] if more > 0 else [])])
    return Condition(FALSE, ordered[0].reason, words[:MESSAGE_CHARACTERS_MAX])
