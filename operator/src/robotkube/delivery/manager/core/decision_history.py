"""The history of decisions about a task, as its status keeps it: what was decided, when, and why.

The condition Accepted says why the demand is met now. Once its releases run, that is because they run; why a candidate
was taken at first is kept here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.foundation.documents.core.shortening import shortened

ENTRIES_MAX = 10
RELEASES_MAX = 50
MESSAGE_CHARACTERS_MAX = 2048

Entry = Mapping[str, Any]
"""time, generation, reason, message and runs, as in the custom resource."""


def with_decision(
    history: Sequence[Entry], generation: int, reason: str, runs: Sequence[str], message: str, now: str
) -> list[Entry]:
    """The history with this decision at its end, unless it is the last one: the same `reason` and what runs (`runs`,
    one text per release) for the same generation. The oldest entries go."""
    decided = {"generation": generation, "reason": reason, "runs": list(runs[:RELEASES_MAX])}
    if history and all(history[-1].get(key) == value for key, value in decided.items()):
        return list(history[-ENTRIES_MAX:])
    return [
        *history[-ENTRIES_MAX + 1 :],
        {"time": now, **decided, "message": shortened(message, MESSAGE_CHARACTERS_MAX)},
    ]
