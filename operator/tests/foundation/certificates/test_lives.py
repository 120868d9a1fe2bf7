"""The life of a certificate: when it is replaced, and why."""

from __future__ import annotations

import pytest

from robotkube.foundation.certificates.core.lives import EARLY_SECONDS_MAX, Life, begin_before, reason_to_replace

DAY = 86_400.0
NAMES = frozenset({"broker", "broker.robotkube"})
LIFE = Life(NAMES, 0.0, 90 * DAY, has_key=True, signed=True)


@pytest.mark.parametrize(
    ("life", "now", "reason"),
    [
        (LIFE, 0.0, ""),
        (LIFE, 60 * DAY - 1, ""),
        (LIFE, 60 * DAY, "two thirds of its life are over"),
        (LIFE, 90 * DAY, "it has expired"),
        (LIFE, -1.0, "it is not valid yet"),
        (None, 0.0, "there is none"),
        (Life(NAMES, 0.0, 90 * DAY, has_key=False, signed=True), 0.0, "its key is another one"),
        (Life(NAMES, 0.0, 90 * DAY, has_key=True, signed=False), 0.0, "another authority signed it"),
        (Life(frozenset({"broker"}), 0.0, 90 * DAY, has_key=True, signed=True), 0.0, "its names changed"),
    ],
)
def test_a_certificate_is_replaced_for_this_reason(life: Life | None, now: float, reason: str) -> None:
    assert reason_to_replace(life, [*NAMES], now) == reason


def test_it_begins_a_little_earlier_but_a_short_one_hardly() -> None:
    assert begin_before(1000.0, 90 * DAY) == 1000.0 - EARLY_SECONDS_MAX
    assert begin_before(1000.0, 60.0) == 999.4
