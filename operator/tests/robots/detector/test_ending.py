"""The end of a detector's process: what still arrives while recordings go on."""

from __future__ import annotations

import time

import pytest

from robotkube.robots.detector.__main__ import finish


@pytest.mark.parametrize(("after_seconds", "taken"), [(0.6, 1), (0.0, 0)])
def test_what_comes_after_the_end_was_asked_for_is_received(after_seconds: float, taken: int) -> None:
    published = received = 0

    def turn() -> int:
        """One message is published after the first turn."""
        nonlocal published, received
        messages, published = published - received, 1
        received += messages
        return messages

    asked = time.monotonic()
    finish(turn, after_seconds)
    assert time.monotonic() - asked >= after_seconds
    assert received == taken
