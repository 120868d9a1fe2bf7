"""Progress of long work: one line when a step starts, one when it ends, on standard error.

A step knows its number, what it is called, how long it took and whether its result was cached. `set_up_seconds`
of the report are these times.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class Step:
    """A running step; `note` is what the closing line adds in brackets, for example `cached`."""

    title: str
    note: str = ""

    def progress(self, text: str) -> None:
        """Print a line of detail below the step's title."""
        print(f"     {text}", file=sys.stderr, flush=True)


@dataclass
class Steps:
    """The steps of one command, in order. `seconds` maps a step's title to its wall time."""

    total: int
    began: float = field(default_factory=time.monotonic)
    seconds: dict[str, float] = field(default_factory=dict)
    number: int = 0

    @contextmanager
    def step(self, title: str) -> Iterator[Step]:
        """Run the body as one step; a failure is reported with the step's name and raised again."""
        self.number += 1
        head = f"[{self.number}/{self.total}]"
        print(f"{head} {title} ...", file=sys.stderr, flush=True)
        step, began = Step(title), time.monotonic()
        try:
            yield step
        except BaseException:
            print(f"{head} {title}: failed after {time.monotonic() - began:.1f} s", file=sys.stderr, flush=True)
            raise
        took = time.monotonic() - began
        self.seconds[title] = round(took, 2)
        note = f" ({step.note})" if step.note else ""
        total = time.monotonic() - self.began
        print(f"{head} {title}: {took:.1f} s{note}, {total:.0f} s in all", file=sys.stderr, flush=True)
