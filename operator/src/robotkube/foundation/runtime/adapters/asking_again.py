"""Asking a server again that ended the connection just then, as the forge does when it takes a renewed certificate."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import TypeVar

from robotkube.backoffs import backoff

Answer = TypeVar("Answer")

ATTEMPTS_MAX = 3  # the kept connection; a new one that the ending server took yet; the next server's
PAUSE_SECONDS_FIRST, PAUSE_SECONDS_MAX = 0.1, 0.2  # between attempts: the port passes to the next server meanwhile


def ask_again(ask: Callable[[], Answer], lost_nothing: Callable[[Exception], bool]) -> Answer:
    """What `ask` returns, called at most ATTEMPTS_MAX times; its error when that was the last time, or when
    `lost_nothing` says that this one is not to be followed by another attempt."""
    for attempt in range(ATTEMPTS_MAX - 1):
        try:
            return ask()
        except Exception as error:
            if not lost_nothing(error):
                raise
        time.sleep(backoff(attempt, PAUSE_SECONDS_FIRST, PAUSE_SECONDS_MAX, random.random))
    return ask()
