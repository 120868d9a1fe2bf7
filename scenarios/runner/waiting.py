"""Waits with a bound: who waits says for what, and what the things involved look like when the time is over."""

from __future__ import annotations

import time
from collections.abc import Callable

POLL_SECONDS = 0.5


class RunError(Exception):
    """The run cannot go on; the message says what was waited for or refused, and the state of the things involved."""


def wait_for(
    what: str,
    seconds: float,
    reached: Callable[[], bool],
    state: Callable[[], str],
    poll_seconds: float = POLL_SECONDS,
    say: Callable[[str], None] | None = None,
) -> float:
    """Polls until `reached`; returns the seconds it took. Raises `RunError` with `state()` when the bound is
    exceeded."""
    began = told = time.monotonic()
    while not reached():
        now = time.monotonic()
        if now - began > seconds:
            raise RunError(f"waited {seconds:.0f} s for {what}, in vain\n{state()}")
        if say and now - told >= 10:
            told = now
            say(f"waiting for {what}: {now - began:.0f} of at most {seconds:.0f} s; {state().splitlines()[0]}")
        time.sleep(poll_seconds)
    return time.monotonic() - began
