"""The end of a detector's process: what still arrives while recordings go on."""

from __future__ import annotations

import threading
import time

import pytest

from robotkube.entrypoints.detector import finish


@pytest.mark.parametrize(("after_seconds", "taken"), [(0.6, 1), (0.0, 0)])
def test_what_comes_after_the_end_was_asked_for_is_received(after_seconds: float, taken: int) -> None:
    arrived: list[int] = []
    received = 0

    def turn() -> int:
        nonlocal received
        found = len(arrived)
        arrived.clear()
        received += found
        return found

    publisher = threading.Timer(0.2, lambda: arrived.append(1))
    publisher.start()
    asked = time.monotonic()
    finish(turn, after_seconds)
    assert time.monotonic() - asked >= after_seconds
    publisher.join()
    assert received == taken
