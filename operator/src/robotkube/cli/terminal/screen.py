"""The screen: the lower end of a terminal, which is drawn anew while lines go by above it.

It is on standard error, as all talk. Where that is no terminal there is none, and whoever has something to show writes
lines instead.
"""

from __future__ import annotations

import functools
import io
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from importlib.util import find_spec
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

REDRAWS_PER_SECOND = 2.0  # a view of 17 agents takes some milliseconds to draw


class LinesAbove(io.TextIOBase):
    """A stream of the process while something is drawn: its lines wait for the next redraw, and go above that, whole
    and never broken, so that they can be copied."""

    def __init__(self, stream: TextIO, lines: deque[str]) -> None:
        self._stream = stream
        self._lines = lines
        self._begun = ""

    def write(self, text: str) -> int:
        """Take the lines that are whole; the rest waits for its end."""
        *lines, self._begun = (self._begun + text).split("\n")
        self._lines.extend(lines)
        return len(text)

    def finish(self) -> None:
        """Take what has no end of line."""
        if self._begun:
            self._lines.append(self._begun)
        self._begun = ""

    def isatty(self) -> bool:
        """A terminal, as the stream itself."""
        return True

    def fileno(self) -> int:
        """Of the stream itself."""
        return self._stream.fileno()


class Screen:
    """The parts that are drawn below everything else, the first one on top. Nothing draws them more often than
    REDRAWS_PER_SECOND, however many lines go by."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self._parts: list[Callable[[], RenderableType]] = []
        self._lines: deque[str] = deque()
        self._lock = threading.Lock()
        self._drawing: _Drawing | None = None

    @contextmanager
    def showing(self, part: Callable[[], RenderableType]) -> Iterator[None]:
        """Draw what `part` gives, again and again, until the body ends; then it is gone from the terminal."""
        with self._lock:
            self._parts.append(part)
            if self._drawing is None:
                self._drawing = _Drawing(self.console, self.drawn, self._lines)
        try:
            yield
        finally:
            with self._lock:
                self._parts.remove(part)
                ended = None if self._parts else self._drawing
                self._drawing = None if ended else self._drawing
            if ended:
                ended.end()

    def drawn(self) -> RenderableType:
        """All parts as they are now."""
        from rich.console import Group

        return Group(*(part() for part in list(self._parts)))


class _Drawing:
    """What is drawn from when there is a part until there is none: the process's streams are caught meanwhile."""

    def __init__(self, console: Console, drawn: Callable[[], RenderableType], lines: deque[str]) -> None:
        from rich.live import Live

        self._live = Live(
            console=console, auto_refresh=False, transient=True, get_renderable=drawn, redirect_stdout=False,
            redirect_stderr=False,
        )  # fmt: skip
        self._console = console
        self._lines = lines
        self._streams = sys.stdout, sys.stderr
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="screen", daemon=True)
        self._live.start(refresh=True)
        sys.stderr = LinesAbove(sys.stderr, lines)
        if sys.stdout.isatty():
            sys.stdout = LinesAbove(sys.stdout, lines)
        self._thread.start()

    def end(self) -> None:
        """Write what still waits, and take away what is drawn."""
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, LinesAbove):
                stream.finish()
        sys.stdout, sys.stderr = self._streams
        self._ending.set()
        self._thread.join()
        self._write_lines()
        self._live.stop()

    def _run(self) -> None:
        while not self._ending.wait(1 / REDRAWS_PER_SECOND):
            if not self._write_lines():
                self._live.refresh()

    def _write_lines(self) -> bool:
        """Write the lines that wait, and what is drawn below them anew; False when there is none."""
        from rich.text import Text

        waiting = [self._lines.popleft() for _ in range(len(self._lines))]
        if waiting:
            self._console.print(Text.from_ansi("\n".join(waiting)), soft_wrap=True)
        return bool(waiting)


@functools.cache
def screen() -> Screen | None:
    """This process's screen; None where standard error is no terminal, or rich is not installed."""
    if not sys.stderr.isatty() or find_spec("rich") is None:
        return None
    from rich.console import Console

    console = Console(stderr=True, highlight=False)
    return None if console.is_dumb_terminal else Screen(console)


def showing(part: Callable[[], RenderableType]) -> AbstractContextManager[None]:
    """Draw `part` on this process's screen while the body runs; without a screen nothing is drawn."""
    shown = screen()
    return shown.showing(part) if shown else nullcontext()
