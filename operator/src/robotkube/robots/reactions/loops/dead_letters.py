"""Dead letters: the last deliveries that reactions have given up."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import Any

from robotkube.robots.reactions.ports.deliveries import DeadLetter

DEAD_LETTERS_MAX = 100

log = logging.getLogger(__name__)


class DeadLetterBox:
    """The dead letters of all reactions of a detector; any thread may add one."""

    def __init__(self, clock_ns: Callable[[], int]) -> None:
        self._clock_ns = clock_ns
        self._letters: deque[DeadLetter] = deque(maxlen=DEAD_LETTERS_MAX)

    def add(self, reaction: str, identity: str, reason: str) -> None:
        """Add an edge that a reaction gives up, and log it."""
        self._letters.append(DeadLetter(reaction, identity, self._clock_ns(), reason))
        log.error("reaction %s: %s given up: %s", reaction, identity, reason)

    def documents(self) -> list[dict[str, Any]]:
        """The last dead letters, oldest first, as JSON values."""
        return [letter.document() for letter in list(self._letters)]
