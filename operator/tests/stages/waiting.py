"""Waiting for what happens elsewhere, with a bound."""

import time
from collections.abc import Callable

WAIT_SECONDS_MAX = 30.0
POLL_SECONDS = 0.02


def until(
    condition: Callable[[], object], what: str = "what the test waits for", seconds: float = WAIT_SECONDS_MAX
) -> None:
    """Until it is true; fails with `what` after `seconds`."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"not within {seconds:.0f} s: {what}"
        time.sleep(POLL_SECONDS)
