"""The resync of gate and manager: when they poll the forge without a notification."""

LOOK_SECONDS = 10.0
LOOK_SECONDS_BUSY = 30.0
QUIET_SECONDS = 1.0


def is_quiet(idle_seconds: float) -> bool:
    """Whether no plan is about to come: the last one is long ago. `idle_seconds`: since then."""
    return idle_seconds > QUIET_SECONDS


def look_is_due(looked_seconds: float, idle_seconds: float) -> bool:
    """Whether a resync is due. While plan follows plan each merge says what main is, and polling only delays the next
    one: it can wait, but not for ever. `looked_seconds`: since the last resync."""
    return looked_seconds >= (LOOK_SECONDS if is_quiet(idle_seconds) else LOOK_SECONDS_BUSY)
