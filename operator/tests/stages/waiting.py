"""Waiting for what happens elsewhere, with a bound.

Waiting costs what is waited for: a look by HTTP takes a forge 10 ms, so looks come ever more seldom, with pauses of a
tenth of what was waited so far.
"""

from __future__ import annotations

import time
from collections.abc import Callable

WAIT_SECONDS_MAX = 30.0
PAUSE_SECONDS_MIN, PAUSE_SECONDS_MAX = 0.02, 0.25
PAUSE_OF_WAITED = 0.1
LOOK_SECONDS_MAX = 0.5  # of a look and the pause before it, that count
STRETCH_MAX = 4.0


def until(
    condition: Callable[[], object],
    what: str = "what the test waits for",
    seconds: float | None = None,
    state: Callable[[], object] = lambda: "",
) -> None:
    """Wait until it is true; fails after `seconds` with `what`, and with the `state` as it is then.

    Without `seconds` it ends what hangs, after WAIT_SECONDS_MAX. Where a look takes longer than LOOK_SECONDS_MAX, the
    machine does other things meanwhile, and it counts as that much: what is waited for is as slow. At most STRETCH_MAX
    times the bound is waited."""
    began = last = time.monotonic()
    waited = 0.0
    bound = seconds or WAIT_SECONDS_MAX
    end = began + bound * (1.0 if seconds else STRETCH_MAX)
    while not condition():
        now = time.monotonic()
        waited += now - last if seconds else min(now - last, LOOK_SECONDS_MAX)
        last = now
        assert max(waited - bound, now - end) < 0, f"not within {now - began:.0f} s: {what} {state()}"
        time.sleep(min(PAUSE_SECONDS_MAX, PAUSE_SECONDS_MIN + PAUSE_OF_WAITED * waited))
