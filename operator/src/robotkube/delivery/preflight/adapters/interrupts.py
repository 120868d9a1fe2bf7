"""Interrupts of a command that has made something: asked to end, it ends as after Ctrl-C, and while it removes what it
made it does not."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], Any] | int | None
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def interruptible() -> Iterator[None]:
    """Have the first of these signals raise KeyboardInterrupt inside; what follows it does nothing."""
    before = [signal.signal(one, _interrupt) for one in ENDING]
    try:
        yield
    finally:
        _restore(before)


@contextmanager
def shielded() -> Iterator[None]:
    """Have none of these signals do anything inside."""
    before = [signal.signal(one, signal.SIG_IGN) for one in ENDING]
    try:
        yield
    finally:
        _restore(before)


def _restore(before: Sequence[Handler]) -> None:
    for one, handler in zip(ENDING, before, strict=True):
        signal.signal(one, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    for one in ENDING:  # a second one would end what the first one began: the removal
        signal.signal(one, signal.SIG_IGN)
    raise KeyboardInterrupt
