"""The resync of gate and manager: when they poll the forge without a notification."""

RESYNC_SECONDS = 10.0
RESYNC_SECONDS_BUSY = 30.0
QUIET_SECONDS = 1.0


def is_quiet(idle_seconds: float) -> bool:
    """Return whether no plan is about to come: the last one is long ago. `idle_seconds`: since then."""
    return idle_seconds > QUIET_SECONDS


def resync_is_due(resynced_seconds: float, idle_seconds: float) -> bool:
    """Return whether a resync is due. While plan follows plan each merge says what main is, and polling only delays the
    next one: it can wait, but not for ever. `resynced_seconds`: since the last resync."""
    return resynced_seconds >= (RESYNC_SECONDS if is_quiet(idle_seconds) else RESYNC_SECONDS_BUSY)
