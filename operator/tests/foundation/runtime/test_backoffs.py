"""Waits before an attempt lie anywhere below a bound that doubles, and every loop that tries again takes them."""

from __future__ import annotations

import random
import re

from hypothesis import given, settings
from hypothesis import strategies as st

from robotkube.backoffs import backoff
from tests.stages.paths import SOURCE

SOURCES = SOURCE / "robotkube"
# a loop that doubles its pause by itself; a rule's process is started anew by the process that it belongs to
DOUBLES = re.compile(r"(pause|backoff|retry_seconds|delay) = min\(|2 \*\* ?worker\.failures|\* 2\*\*worker\.failures")
ALONE = {"workers.py"}
REPEATS = re.compile(r"^(RETRY|AGAIN|FAILURE)_SECONDS", re.MULTILINE)
BACKS_OFF = re.compile(r"\b(backoff|step_when_woken)\(")
NO_PAUSE = {"asking.py": "what the console says to a browser (Retry-After)", "settings.py": "bounds of a key"}


def test_the_bound_doubles_up_to_the_maximum() -> None:
    nearly_one = 1 - 2**-53
    waits = [backoff(attempt, 0.2, 5.0, lambda: nearly_one) for attempt in range(7)]
    assert [round(wait, 6) for wait in waits] == [0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0]
    assert backoff(10**9, 0.2, 5.0, lambda: 0.5) == 2.5
    assert backoff(3, 0.2, 5.0, lambda: 0.0) == 0.0


@given(st.integers(0, 10**6), st.floats(0.001, 10), st.floats(10, 100), st.randoms())
def test_a_wait_is_never_longer_than_the_bound(
    attempt: int, minimum: float, maximum: float, source: random.Random
) -> None:
    assert 0 <= backoff(attempt, minimum, maximum, source.random) <= maximum


@given(st.randoms(use_true_random=True))
@settings(max_examples=3)
def test_waits_spread_over_the_whole_time(source: random.Random) -> None:
    waits = [backoff(2, 1.0, 60.0, source.random) for _ in range(1000)]
    assert all(any(low <= wait < low + 0.5 for wait in waits) for low in (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5))


def test_no_loop_doubles_its_pause_by_itself() -> None:
    doubling = {path.name for path in SOURCES.rglob("*.py") if DOUBLES.search(path.read_text())}
    assert doubling == ALONE


def test_no_loop_repeats_what_failed_after_a_pause_that_is_always_the_same() -> None:
    texts = {path.name: path.read_text() for path in SOURCES.rglob("*.py") if REPEATS.search(path.read_text())}
    assert {name for name, text in texts.items() if not BACKS_OFF.search(text)} == ALONE | set(NO_PAUSE)
