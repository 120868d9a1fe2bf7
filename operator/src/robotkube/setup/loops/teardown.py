"""Ending all releases before the platform is uninstalled.

The order matters: while Argo CD deletes what it made, it needs the AppProject; while a recorder ends its recording, it
needs its account, the broker and the database. So this runs before Helm deletes any of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from robotkube.errors import RobotKubeError, UnavailableError
from robotkube.setup.ports import InstalledReleases

POLL_SECONDS = 1.0
NAMED_MAX = 5


@dataclass(frozen=True)
class TeardownClock:
    """The time in seconds that never go back, and a sleep that is false when the process shall end."""

    now: Callable[[], float]
    sleep: Callable[[float], bool]


def tear_down(releases: InstalledReleases, wait_seconds: float, clock: TeardownClock) -> int:
    """Withdraw all releases and wait at most `wait_seconds` until they are gone; how many there were.

    A passing fault of the API server is tried again within the same time. UnavailableError when the time is over, with
    the names of what is left and what to do.
    """
    deadline = clock.now() + wait_seconds
    most = 0
    last = "nothing was tried"
    while True:
        try:
            releases.withdraw()
            left = releases.remaining()
            most = max(most, len(left))
            last = f"still there: {_named(left)}"
            if not left:
                return most
        except RobotKubeError as error:
            if not error.retriable:
                raise
            last = str(error)
        if clock.now() >= deadline or not clock.sleep(POLL_SECONDS):
            raise UnavailableError(f"releases did not end within {wait_seconds:g} s; {last}. {_FIX}")


_FIX = (
    "See whether Argo CD's application controller runs, then uninstall again; "
    "`helm uninstall --no-hooks` goes on without waiting and may leave Applications behind"
)


def _named(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED_MAX} more" if len(names) > NAMED_MAX else ""
    return ", ".join(names[:NAMED_MAX]) + more
