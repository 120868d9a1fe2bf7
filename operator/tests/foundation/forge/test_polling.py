"""When gate and manager look although nobody told them of anything."""

from __future__ import annotations

import pytest

from robotkube.foundation.forge.core.polling import LOOK_SECONDS, LOOK_SECONDS_BUSY, QUIET_SECONDS, look_is_due


@pytest.mark.parametrize(
    ("looked", "idle", "due"),
    [
        (LOOK_SECONDS - 0.1, 100.0, False),
        (LOOK_SECONDS, QUIET_SECONDS + 0.1, True),
        (LOOK_SECONDS, QUIET_SECONDS, False),
        (LOOK_SECONDS_BUSY - 0.1, 0.0, False),
        (LOOK_SECONDS_BUSY, 0.0, True),
    ],
)
def test_a_look_waits_while_plan_follows_plan_but_not_for_ever(looked: float, idle: float, due: bool) -> None:
    assert look_is_due(looked, idle) == due
