"""Progress of long work, on standard error: one line when a step starts and one when it ends; on a terminal a bar while
it runs, and the line when it ends.

A step knows its number, what it is called, how long it took and whether its result was cached. `set_up_seconds`
of the report are these times.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from ci.durations import Durations
from robotkube.cli.terminal import screen
from robotkube.cli.terminal.bars import bar

CACHED = "cached"


@dataclass
class Step:
    """A running step; `note` is what the closing line adds in brackets, for example `cached`. `inner` are the steps
    that ended in it, each with whether something was done."""

    title: str
    note: str = ""
    inner: list[bool] = field(default_factory=list)

    @property
    def is_done_anew(self) -> bool:
        """Return whether it took what it takes: nothing was cached, or something in it was not."""
        return any(self.inner) if self.inner else not self.note.startswith(CACHED)

    def progress(self, text: str) -> None:
        """Print a line of detail below the step's title."""
        print(f"     {text}", file=sys.stderr, flush=True)


_running: list[Step] = []
"""The steps that run, one in the other."""


@dataclass
class Steps:
    """The steps of one command, in order. `seconds` maps a step's title to its wall time."""

    total: int
    began: float = field(default_factory=time.monotonic)
    seconds: dict[str, float] = field(default_factory=dict)
    number: int = 0
    durations: Durations = field(default_factory=Durations)

    @contextmanager
    def step(self, title: str, of: str = "") -> Iterator[Step]:
        """Run the body as one step; a failure is reported with the step's name and raised again. Its bar is as long as
        it took the last time, where that was a step of the same title, and `of` the same."""
        self.number += 1
        head = f"[{self.number}/{self.total}]"
        if screen.screen() is None:
            print(f"{head} {title} ...", file=sys.stderr, flush=True)
        step = Step(title)
        began = time.monotonic()
        kind = f"{title} of {of}" if of else title
        _running.append(step)
        try:
            with screen.showing(bar(f"{head} {title}", began, self.durations.last(kind))):
                yield step
        except BaseException:
            print(f"{head} {title}: failed after {time.monotonic() - began:.1f} s", file=sys.stderr, flush=True)
            raise
        finally:
            _running.remove(step)
        took = time.monotonic() - began
        self.seconds[title] = round(took, 2)
        self._keep(step, kind, took)
        note = f" ({step.note})" if step.note else ""
        total = time.monotonic() - self.began
        print(f"{head} {title}: {took:.1f} s{note}, {total:.0f} s in all", file=sys.stderr, flush=True)

    def _keep(self, step: Step, kind: str, took: float) -> None:
        if step.is_done_anew:
            self.durations.note(kind, took)
        if _running:
            _running[-1].inner.append(step.is_done_anew)
