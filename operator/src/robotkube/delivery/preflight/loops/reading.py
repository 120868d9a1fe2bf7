"""Reading of facts at the same time, until a deadline: what is not there by then was not read, and says so.

Threads that still wait at the deadline do not keep the process; each of their requests has a bound of its own.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

from robotkube.delivery.preflight.core.findings import Unread
from robotkube.errors import RobotKubeError, UnavailableError

Clock = Callable[[], float]


class FactReading:
    """The facts of these readers. A reader gets this object, and asks it for the facts that its own rests on."""

    def __init__(
        self, readers: Mapping[str, Callable[[FactReading], Any]], seconds: float, clock: Clock = time.monotonic
    ) -> None:
        self._readers = readers
        self._seconds = seconds
        self._clock = clock
        self._end = clock() + seconds
        self._made: dict[str, Future[Any]] = {name: Future() for name in readers}

    def facts(self) -> dict[str, Any]:
        """All facts; Unread where one could not be read."""
        for name in self._readers:
            threading.Thread(target=self._read, args=(name,), name=f"read {name}", daemon=True).start()
        return {name: self._fact(name) for name in self._readers}

    def needed(self, name: str) -> Any:
        """A fact for another one; UnavailableError, with why, when it was not read."""
        fact = self._fact(name)
        if isinstance(fact, Unread):
            raise UnavailableError(fact.why)
        return fact

    def left(self) -> float:
        """Seconds until the deadline."""
        return max(0.0, self._end - self._clock())

    def _fact(self, name: str) -> Any:
        try:
            return self._made[name].result(self.left())
        except TimeoutError:
            return Unread(f"timed out: {name} was not read within {self._seconds:g} s")

    def _read(self, name: str) -> None:
        made = self._made[name]
        try:
            made.set_result(self._readers[name](self))
        except RobotKubeError as error:
            made.set_result(Unread(str(error)))
        except BaseException as error:
            made.set_exception(error)
