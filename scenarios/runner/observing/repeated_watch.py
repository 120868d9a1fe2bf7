"""Watches of the API server in a thread of their own, begun again when they end or fail."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any

from kubernetes import watch

WATCH_SECONDS = 300
STOP_SECONDS_MAX = 5.0
PAUSE_SECONDS = 1.0


class RepeatedWatch(ABC):
    """A watch from `start` to `stop`. `what` names its objects; `progress` is told when it begins again."""

    def __init__(self, what: str, progress: Callable[[str], None]) -> None:
        self._what = what
        self._progress = progress
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._watch: Any = None
        self._thread = threading.Thread(target=self._run, name=what, daemon=True)

    def start(self) -> None:
        """Begin to watch; what is there already is noted with the time of its first event."""
        self._thread.start()

    def stop(self) -> None:
        """End the watch; bounded, since it may be silent."""
        self._ending.set()
        if self._watch is not None:
            self._watch.stop()
        self._thread.join(STOP_SECONDS_MAX)

    @abstractmethod
    def _watch_once(self) -> None:
        """One watch: what is there, then its events until it ends."""

    def _events(self, listing: Callable[..., Any], *arguments: str, since: str) -> Iterator[tuple[str, Any]]:
        """Kind and object of each event after resource version `since`, until the watch ends or `stop` is called."""
        self._watch = watch.Watch()
        stream = self._watch.stream(listing, *arguments, resource_version=since, timeout_seconds=WATCH_SECONDS)
        for event in stream:
            yield event["type"], event["object"]
            if self._ending.is_set():
                return

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                self._watch_once()
            except Exception as error:
                if not self._ending.is_set():
                    self._progress(f"watch of the {self._what} begins again: {type(error).__name__}")
                    self._ending.wait(PAUSE_SECONDS)
