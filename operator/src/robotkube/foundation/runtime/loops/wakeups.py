"""Wake-ups of a loop whose subject changes elsewhere: a step when somebody says so, and now and then without."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable

from robotkube.backoffs import Random, backoff


def step_when_woken(
    step: Callable[[], bool],
    woken: threading.Event,
    stopping: threading.Event,
    seconds: float,
    retry_seconds: tuple[float, float],
    jitter: Random = random.random,
) -> None:
    """Step whenever `woken` is set, else after `seconds`, after failed steps (False) after a back-off; ends when
    `stopping` is set and then `woken`. What is said during a step leads to another one. `retry_seconds`: the bound of
    the pause after a first failure, and of all."""
    failures = 0
    while not stopping.is_set():
        failures = 0 if step() else failures + 1
        woken.wait(backoff(failures - 1, *retry_seconds, jitter) if failures else seconds)
        woken.clear()
