"""A reconciler that lasts: what goes wrong is said once and tried again, and how old the list may be is known.

The list is that of main when main was read and nothing was left to write. From then on it is confirmed with each look;
while forge or API server are away it may be older than main, and says since when.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from robotkube.errors import RobotKubeError
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS
from robotkube.foundation.runtime.loops.wakeups import step_when_woken
from robotkube.foundation.runtime.ports import Series, by_one
from robotkube.registry.admission.core.listing import AllowedVersions

RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 1.0, 2.0

log = logging.getLogger(__name__)


class Reconciler(Protocol):
    """What a follower steps: `PolicyReconciler`."""

    @property
    def tip(self) -> str:
        """Main's tip as it was seen last; empty before that."""
        ...

    @property
    def written(self) -> AllowedVersions | None:
        """The list that was written last; None when none was."""
        ...

    def step(self) -> bool:
        """One look; whether something was written."""
        ...


@dataclass
class FollowerStatistics:
    """Counters since the start: steps that wrote something, and steps that failed."""

    written: int = 0
    failed: int = 0


class Follower:
    """Steps of a reconciler, on one thread; `wake` from any. `monotonic` is a clock in seconds that never goes back;
    `errors` are those that pass, so that the next step is tried."""

    def __init__(
        self,
        reconciler: Reconciler,
        monotonic: Callable[[], float],
        errors: tuple[type[Exception], ...] = (RobotKubeError,),
    ) -> None:
        self._reconciler = reconciler
        self._monotonic = monotonic
        self._errors = errors
        self._woken = threading.Event()
        self._announced = ""
        self._confirmed_at = monotonic()
        self.problem = ""
        self.statistics = FollowerStatistics()

    def wake(self, tip: str = "") -> None:
        """Something changed: the next step is now. `tip`: of main, where it was told."""
        self._announced = tip or self._announced
        self._woken.set()

    def step(self) -> bool:
        """One step; False when it failed. A problem is logged when it comes and when it is another one."""
        announced, self._announced = self._announced, ""
        try:
            self.statistics.written += self._reconciler.step()
        except self._errors as error:
            self.statistics.failed += 1
            self._announced = self._announced or announced
            if str(error) != self.problem:
                log.warning("admission: the policies stay as they are: %s", error)
            self.problem = str(error)
            return False
        if self.problem:
            log.info("admission: main is followed again after_seconds=%d", self.unconfirmed_seconds)
        self.problem = ""
        self._confirmed_at = self._monotonic()
        return True

    def run(self, stopping: threading.Event) -> None:
        """Step when woken, and now and then without, until `stopping` is set (and `wake` called)."""
        retry_seconds = (RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX)
        step_when_woken(self.step, self._woken, stopping, RESYNC_SECONDS, retry_seconds)

    @property
    def unconfirmed_seconds(self) -> float:
        """How long ago the list was last known to be that of main."""
        return self._monotonic() - self._confirmed_at

    def reasons_not_ready(self) -> Sequence[str]:
        """Why this is not ready: the list is not that of main as it was seen or announced last. Main that cannot be
        read is none: the last list stays, and is the right one as far as is known."""
        written = self._reconciler.written
        tip = self._announced or self._reconciler.tip
        because = f": {self.problem}" if self.problem else ""
        if written is None:
            return [f"no list was written yet{because}"]
        if not tip:
            return [f"main of the catalogue was not read yet{because}"]
        if written.commit != tip:
            return [f"the list is that of {written.commit[:12] or 'no commit'}, main is at {tip[:12]}{because}"]
        return []

    def metrics(self) -> Sequence[Series]:
        """What Prometheus reads."""
        written = self._reconciler.written or AllowedVersions()
        listed = {"charts": float(len(written.charts)), "images": float(len(written.verified))}
        prefix = "robotkube_admission_"
        statistics = self.statistics
        text = "Seconds since the list was last known to be that of the catalogue's main."
        return (
            Series(f"{prefix}listed", "gauge", "Digests that may run.", by_one(listed), ("kind",)),
            Series(f"{prefix}unconfirmed_seconds", "gauge", text, {(): self.unconfirmed_seconds}),
            Series(
                f"{prefix}behind",
                "gauge",
                "1 while the list is not that of main as it was seen or announced last, else 0.",
                {(): float(bool(self.reasons_not_ready()))},
            ),
            Series(f"{prefix}writes_total", "counter", "Steps that wrote something.", {(): statistics.written}),
            Series(f"{prefix}failures_total", "counter", "Steps that failed.", {(): statistics.failed}),
        )
