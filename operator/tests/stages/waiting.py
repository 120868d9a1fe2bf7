"""Waiting for what happens elsewhere, with a bound."""

import time
from collections.abc import Callable

WAIT_SECONDS_MAX = 30.0
POLL_SECONDS = 0.02


def until(
    condition: Callable[[], object],
    what: str = "what the test waits for",
    seconds: float = WAIT_SECONDS_MAX,
    state: Callable[[], object] = lambda: "",
) -> None:
    """Until it is true; fails after `seconds` with `what`, and with the `state` as it is then."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"not within {seconds:.0f} s: {what} {state()}"
        time.sleep(POLL_SECONDS)
