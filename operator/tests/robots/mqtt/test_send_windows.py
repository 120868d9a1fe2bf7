"""The window of a connection in front of an uplink of any rate: the queue stays short, and nothing is held back that
the uplink could carry."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.robots.mqtt.core.send_windows import BYTES_FIRST, BYTES_MAX, BYTES_MIN, QUEUE_SECONDS, SendWindow

CHANGES = 60


def settled(bytes_per_second: float, base_seconds: float, window: SendWindow | None = None) -> SendWindow:
    """A window behind an uplink of that rate, whose connection always has more to send."""
    window = window or SendWindow()
    now = 0.0
    for _ in range(CHANGES):
        window.change(now, round_trip(window, bytes_per_second, base_seconds), base_seconds)
        now += 10.0
    return window


def round_trip(window: SendWindow, bytes_per_second: float, base_seconds: float) -> float:
    return max(base_seconds, window.bytes / bytes_per_second)


@given(st.floats(1e5, 1e9), st.floats(1e-4, 0.3))
def test_the_queue_is_short_and_the_uplink_full(bytes_per_second: float, base_seconds: float) -> None:
    window = settled(bytes_per_second, base_seconds)
    queue = round_trip(window, bytes_per_second, base_seconds) - base_seconds
    assert queue <= 1.1 * QUEUE_SECONDS or window.bytes == BYTES_MIN
    assert window.bytes >= 0.9 * bytes_per_second * base_seconds or window.bytes == BYTES_MAX


def test_an_uplink_that_became_narrow_is_followed_within_some_changes() -> None:
    window = settled(1e9, 0.02)
    assert window.bytes == BYTES_MAX
    settled(2.5e6, 0.02, window)
    assert round_trip(window, 2.5e6, 0.02) - 0.02 == pytest.approx(QUEUE_SECONDS, rel=0.1)


def test_it_changes_only_when_the_last_change_can_have_shown() -> None:
    window = SendWindow()
    assert window.due(0.0)
    window.change(0.0, 0.2, 0.2)
    assert window.bytes > BYTES_FIRST
    assert not window.due(0.39)
    assert window.due(0.41)


def test_without_a_measurement_it_stays() -> None:
    window = SendWindow()
    window.change(0.0, 0.0, 0.0)
    assert window.bytes == BYTES_FIRST
