"""When gate and manager look at the forge although nobody has told them of anything."""

LOOK_SECONDS = 10.0
LOOK_SECONDS_BUSY = 30.0
QUIET_SECONDS = 1.0


def is_quiet(idle_seconds: float) -> bool:
    """Whether the last plan is so long ago that the next one is not about to come. `idle_seconds`: since then."""
    return idle_seconds > QUIET_SECONDS


def look_is_due(looked_seconds: float, idle_seconds: float) -> bool:
    """Whether to look now. While plan follows plan each merge says what main is, and looking only holds the next one
    up: it can wait, but not for ever. `looked_seconds`: since the last look."""
    return looked_seconds >= (LOOK_SECONDS if is_quiet(idle_seconds) else LOOK_SECONDS_BUSY)
