"""Waits with a bound: who waits names for what, and describes the things involved when the time is over."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from robotkube.cli.terminal import screen

if TYPE_CHECKING:
    from rich.console import RenderableType

POLL_SECONDS = 0.5
PROGRESS_SECONDS = 10.0


class RunError(Exception):
    """The run cannot go on; the message says what was waited for or refused, and the state of the things involved."""


def wait_for(
    what: str,
    seconds: float,
    reached: Callable[[], bool],
    state: Callable[[], str],
    poll_seconds: float = POLL_SECONDS,
    progress: Callable[[str], None] | None = None,
) -> float:
    """Polls until `reached`; returns the seconds it took. Raises `RunError` with `state()` when the bound is exceeded.

    A poll that fails (`RunError`: somebody does not answer) is repeated; the last failure is part of the message.
    `progress` is told what is still missing, once: again only when that has changed. A terminal shows meanwhile for
    what it waits and how long.
    """
    with screen.showing(_waiting(what, seconds, time.monotonic())):
        return _polled(what, seconds, reached, state, poll_seconds, progress)


def _waiting(what: str, seconds: float, began: float) -> Callable[[], RenderableType]:
    def drawn() -> RenderableType:
        from rich.text import Text

        return Text(f"waiting for {what}: {time.monotonic() - began:.0f} of at most {seconds:.0f} s", style="dim")

    return drawn


def _polled(
    what: str,
    seconds: float,
    reached: Callable[[], bool],
    state: Callable[[], str],
    poll_seconds: float,
    progress: Callable[[str], None] | None,
) -> float:
    began = reported = time.monotonic()
    failure = said = ""
    while True:
        try:
            if reached():
                return time.monotonic() - began
            failure = ""
        except RunError as error:
            failure = f"\nthe last poll failed: {error}"
        now = time.monotonic()
        if now - began > seconds:
            raise RunError(f"waited {seconds:.0f} s for {what}, in vain{failure}\n{state()}")
        if progress and now - reported >= PROGRESS_SECONDS:
            reported = now
            missing = f"{state().splitlines()[0]}{failure}"
            if missing != said:
                progress(f"waiting for {what}: {missing}")
            said = missing
        time.sleep(poll_seconds)
