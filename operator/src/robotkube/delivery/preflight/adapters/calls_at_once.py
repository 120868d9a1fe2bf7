"""Calls that wait, several at the same time, on threads that do not keep the process."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any

AT_ONCE = 8


def at_once(calls: Sequence[Callable[[], Any]]) -> list[Any]:
    """The results of these calls in their order, AT_ONCE of them at a time; the first error, when one raises one."""
    waiting: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None] = queue.SimpleQueue()
    made: list[Future[Any]] = []
    for call in calls:
        made.append(Future())
        waiting.put((call, made[-1]))
    for _ in range(min(AT_ONCE, len(calls))):
        waiting.put(None)  # after all calls: the end of one thread
        threading.Thread(target=_work, args=(waiting,), name="read at once", daemon=True).start()
    return [one.result() for one in made]


def _work(waiting: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None]) -> None:
    for call, made in iter(waiting.get, None):
        try:
            made.set_result(call())
        except BaseException as error:
            made.set_exception(error)
