"""Waits with a bound: who waits names for what, and describes the things involved when the time is over."""

from __future__ import annotations

import time
from collections.abc import Callable

POLL_SECONDS = 0.5
PROGRESS_SECONDS = 10.0


class RunError(Exception):
    """The run cannot go on; the message says what was waited for or refused, and the state of the things involved."""


def wait_for(
    what: str,
    seconds: float,
    reached: Callable[[], bool],
    state: Callable[[], str],
    poll_seconds: float = POLL_SECONDS,
    progress: Callable[[str], None] | None = None,
) -> float:
    """Polls until `reached`; returns the seconds it took. Raises `RunError` with `state()` when the bound is exceeded.

    A poll that fails (`RunError`: somebody does not answer) is repeated; the last failure is part of the message.
    """
    began = reported = time.monotonic()
    failure = ""
    while True:
        try:
            if reached():
                return time.monotonic() - began
            failure = ""
        except RunError as error:
            failure = f"\nthe last poll failed: {error}"
        now = time.monotonic()
        if now - began > seconds:
            raise RunError(f"waited {seconds:.0f} s for {what}, in vain{failure}\n{state()}")
        if progress and now - reported >= PROGRESS_SECONDS:
            reported = now
            progress(
                f"waiting for {what}: {now - began:.0f} of at most {seconds:.0f} s; {state().splitlines()[0]}{failure}"
            )
        time.sleep(poll_seconds)
