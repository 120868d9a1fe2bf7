"""Following something that changes elsewhere: a step when somebody says so, and now and then without."""

from __future__ import annotations

import threading
from collections.abc import Callable


def step_when_woken(
    step: Callable[[], bool], woken: threading.Event, stopping: threading.Event, seconds: float, retry_seconds: float
) -> None:
    """Step whenever `woken` is set, else after `seconds`, after a failed step (False) after `retry_seconds`; ends when
    `stopping` is set and then `woken`. What is said during a step leads to another one."""
    while not stopping.is_set():
        done = step()
        woken.wait(seconds if done else retry_seconds)
        woken.clear()
