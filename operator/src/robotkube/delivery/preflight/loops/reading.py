"""Reading of facts at the same time, until a deadline: what is not there by then was not read, and says so.

Threads that still wait at the deadline do not keep the process; each of their requests has a bound of its own.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from typing import Any

from robotkube.delivery.preflight.core.findings import Unread
from robotkube.errors import RobotKubeError, UnavailableError

AT_ONCE = 8
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


def at_once(calls: Sequence[Callable[[], Any]]) -> list[Any]:
    """The results of these calls in their order, AT_ONCE of them at a time; the first error, when one raises one."""
    waiting: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = queue.SimpleQueue()
    made: list[Future[Any]] = []
    for call in calls:
        made.append(Future())
        waiting.put((call, made[-1]))
    for _ in range(min(AT_ONCE, len(calls))):
        threading.Thread(target=_work, args=(waiting,), name="read at once", daemon=True).start()
    return [one.result() for one in made]


def _work(waiting: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]]) -> None:
    while True:
        try:
            call, made = waiting.get_nowait()
        except queue.Empty:
            return
        try:
            made.set_result(call())
        except BaseException as error:
            made.set_exception(error)
