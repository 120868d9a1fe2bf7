"""Server-sent events: what changed after a version, as it changes (WHATWG HTML, section 9.2).

A reader that is slower than the changes gets fewer and larger ones, since nothing is queued for him: each event is made
of the table when he takes it.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager

from robotkube.delivery.console.adapters.web.encoding import change_text
from robotkube.delivery.console.core.table import resume_id
from robotkube.delivery.console.ports import ModelReading

HEARTBEAT_SECONDS = 5.0
GATHERING_SECONDS = 0.05
STREAM_SECONDS_MAX = 3600.0
STREAMS_MAX = 500
STREAMS_OF_A_SOURCE_MAX = 20
PADDING = f": {'.' * 2048}\n\n"
HEADERS = {
    "Content-Type": "text/event-stream; charset=utf-8",
    "Cache-Control": "no-store, no-transform",
    "X-Accel-Buffering": "no",
}
STALE = (
    "What changed since then is not known any more: the console began anew, or the connection was lost for too long."
)


class Wakeups:
    """Wakes all streams of one event loop when the model changed, from whichever thread changed it."""

    def __init__(self) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None
        self._waiting: set[asyncio.Event] = set()
        self._called = False

    def changed(self) -> None:
        """The model changed; for any thread. Many changes before the loop's turn are one call."""
        if self._loop is not None and not self._called and not self._loop.is_closed():
            self._called = True
            self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self._called = False
        for event in self._waiting:
            event.set()

    @contextmanager
    def waiting(self) -> Iterator[asyncio.Event]:
        """An event that is set by changes from now on."""
        self._loop = asyncio.get_running_loop()
        event = asyncio.Event()
        self._waiting.add(event)
        try:
            yield event
        finally:
            self._waiting.discard(event)

    @property
    def count(self) -> int:
        """How many streams there are."""
        return len(self._waiting)


class Streams:
    """The streams of a model."""

    def __init__(self, model: ModelReading, monotonic: Callable[[], float]) -> None:
        self._model = model
        self._monotonic = monotonic
        self._kept: tuple[int, int, str] = (-1, -1, "")
        self._sources: dict[str, int] = {}
        self.wakeups = Wakeups()
        self.resyncs = 0
        self.stopping = False
        model.listen(self.wakeups.changed)

    def has_place(self, source: str) -> bool:
        """Return whether one more stream may begin, for this source."""
        return self.wakeups.count < STREAMS_MAX and self._sources.get(source, 0) < STREAMS_OF_A_SOURCE_MAX

    def change(self, version: int) -> tuple[int, str] | None:
        """The version reached and the change after `version` as text, empty when nothing changed; None: too old. Who
        reads in step shares the text."""
        change = self._model.since(version)
        if change is None:
            return None
        if not change:
            return change.version, ""
        if self._kept[:2] != (version, change.version):
            text = change_text(change, self._model.epoch, self._model.now_ms())
            self._kept = (version, change.version, text)
        return change.version, self._kept[2]

    async def events(self, version: int | None, source: str, allowed: Callable[[], bool]) -> AsyncIterator[str]:
        """The events after `version` (None: not one of this epoch), while `allowed`."""
        self._sources[source] = self._sources.get(source, 0) + 1
        try:
            with self.wakeups.waiting() as woken:
                async for text in self._events(version, woken, allowed):
                    yield text
        finally:
            self._sources[source] -= 1
            if not self._sources[source]:
                del self._sources[source]

    async def _events(
        self, version: int | None, woken: asyncio.Event, allowed: Callable[[], bool]
    ) -> AsyncIterator[str]:
        yield PADDING + self._heartbeat()
        end = self._monotonic() + STREAM_SECONDS_MAX
        while not self.stopping and self._monotonic() < end and allowed():
            woken.clear()
            change = None if version is None else self.change(version)
            if change is None:
                self.resyncs += 1
                yield _event("resync", json.dumps({"reason": STALE}))
                return
            version, text = change
            if text:
                yield _event("change", text, resume_id(self._model.epoch, version))
            try:
                await asyncio.wait_for(woken.wait(), HEARTBEAT_SECONDS)
            except TimeoutError:
                yield self._heartbeat()
            else:
                await asyncio.sleep(GATHERING_SECONDS)  # what changes together is told together

    def _heartbeat(self) -> str:
        return _event("heartbeat", json.dumps({"version": self._model.version, "time_ms": self._model.now_ms()}))

    def stop(self) -> None:
        """End all streams; for any thread."""
        self.stopping = True
        self.wakeups.changed()


def _event(name: str, data: str, identity: str = "") -> str:
    head = f"id: {identity}\n" if identity else ""
    return f"{head}event: {name}\ndata: {data}\n\n"
