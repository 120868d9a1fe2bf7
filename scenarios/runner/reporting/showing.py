"""Shows a run while it goes on: each moment as a line with its time, on a terminal above a view of the fleet.

It is for people alone. What the report says comes from what the run watches itself; here nothing is measured, and what
cannot be shown is no fault of the run.
"""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from robotkube.cli.live.feed import Feed, LivePlatform
from robotkube.cli.live.moments import Moment
from robotkube.cli.live.view import clock
from robotkube.cli.live.watch import part
from robotkube.cli.platform import Platform
from robotkube.cli.terminal import screen
from scenarios.runner.inputs import NANOSECONDS
from scenarios.runner.platform.access import ARGOCD, PLATFORM

STEP_SECONDS = 0.5
STOP_SECONDS_MAX = 15.0


class Showing:
    """One run that is shown: `tell` writes a line. Until it has `begun`, pods that start are no lines: there are dozens
    of them, and the view counts them."""

    def __init__(self, platform: LivePlatform, report: Callable[[str], None], shown: screen.Screen | None) -> None:
        self._report_line, self._shown = report, shown
        self._started: int | None = None
        self._ending = threading.Event()
        self._feed = Feed(platform, self._report, time.time_ns, with_rates=shown is not None)
        self._feed.tells_pods = False
        self._thread = threading.Thread(target=self._run, name="showing", daemon=True)

    def begin(self, started: int) -> None:
        """The story begins at `started` (ns since 1970): lines have seconds since then."""
        self._started = started
        self._feed.tells_pods = True

    @contextmanager
    def going_on(self) -> Iterator[None]:
        """Shows what happens until the body ends."""
        self._thread.start()
        try:
            with screen.showing(part(self._feed, self._shown)) if self._shown else nullcontext():
                yield
        finally:
            self._ending.set()
            self._thread.join(STOP_SECONDS_MAX)

    def _run(self) -> None:
        try:
            self._feed.start()
            while not self._ending.is_set():
                self._feed.step(STEP_SECONDS)
        except Exception as error:  # of any library: the run goes on, and nobody takes an old picture for a new one
            self._feed.picture.problem = f"{type(error).__name__}: {error}"
            self._report_line(f"what happens is not shown any more: {self._feed.picture.problem}")
        self._feed.stop()

    def _report(self, moment: Moment) -> None:
        self._report_line(f"{since(moment.time, self._started)}  {moment.words}")


def since(moment: int, started: int | None) -> str:
    """The time of a moment, as in the report's timeline; before the story, by the clock."""
    if started is None or moment < started:
        return f"{clock(moment):>11}"
    return f"{(moment - started) / NANOSECONDS:9.3f} s"


def showing(kubeconfig: Path, report: Callable[[str], None]) -> Showing:
    """Shows a run on the cluster of `kubeconfig`."""
    options = {"kubeconfig": str(kubeconfig), "context": None, "manager": "manager"}
    places = {"platform_namespace": PLATFORM, "argocd_namespace": ARGOCD}
    return Showing(Platform(argparse.Namespace(**options, **places)), report, screen.screen())
