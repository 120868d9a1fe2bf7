"""A step when somebody says so, and now and then without; after failures a back-off that differs from process to
process."""

from __future__ import annotations

import threading
from collections.abc import Iterator

from robotkube.foundation.runtime.loops.wakeups import step_when_woken
from tests.stages.pauses import Pauses


def pauses_after(*results: bool) -> list[float]:
    """The seconds that follow each step, with 10 s between steps, bounds of 1 and 3 s, and half of a bound taken."""
    stopping = threading.Event()
    woken = Pauses(len(results), stopping)
    outcomes: Iterator[bool] = iter(results)
    step_when_woken(lambda: next(outcomes), woken, stopping, 10.0, (1.0, 3.0), lambda: 0.5)
    return woken.seconds


def test_steps_that_succeed_follow_each_other_by_the_usual_time() -> None:
    assert pauses_after(True, True) == [10.0, 10.0]


def test_pauses_after_failures_double_up_to_their_bound_and_begin_anew_after_a_success() -> None:
    assert pauses_after(False, False, False, False, True, False) == [0.5, 1.0, 1.5, 1.5, 10.0, 0.5]
