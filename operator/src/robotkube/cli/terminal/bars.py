"""Bars of work that is under way: how long it has taken, and how long the same work took when it was last done."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import RenderableType

BAR_CHARACTERS = 30
SHOWN_AFTER_SECONDS = 1.0  # what is done sooner needs no bar


def estimate(taken: float, last: float | None) -> str:
    """What can be said of the time that work takes: how long it took the `last` time, and nothing where nobody
    knows."""
    if last is None:
        return f"{taken:.0f} s; how long it takes is not known yet"
    if taken > last:
        return f"{taken:.0f} s, longer than the {last:.0f} s of the last time"
    return f"{taken:.0f} of about {last:.0f} s, as long as it took the last time"


def bar(title: str, began: float, last: float | None) -> Callable[[], RenderableType]:
    """A line with a bar: the share of the `last` time that is over; without one the bar only moves. `began` by the
    monotonic clock."""

    def drawn() -> RenderableType:
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        taken = time.monotonic() - began
        known = last is not None and taken <= last
        share = ProgressBar(total=last if known else None, completed=taken, width=BAR_CHARACTERS, pulse=not known)
        row = Table.grid(padding=(0, 1))
        row.add_row(Text(title), share, Text(estimate(taken, last), style="dim"))
        return row

    return drawn


def working(what: str, began: float) -> Callable[[], RenderableType]:
    """A line that says that a command is at work and for how long; nothing in the first second."""

    def drawn() -> RenderableType:
        from rich.text import Text

        taken = time.monotonic() - began
        return Text(f"{what}: {taken:.0f} s" if taken >= SHOWN_AFTER_SECONDS else "", style="dim", end="")

    return drawn
