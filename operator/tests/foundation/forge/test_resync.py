"""Resyncs: gate and manager read everything again although nobody notified them."""

from __future__ import annotations

import pytest

from robotkube.foundation.forge.core.resync import QUIET_SECONDS, RESYNC_SECONDS, RESYNC_SECONDS_BUSY, resync_is_due


@pytest.mark.parametrize(
    ("resynced", "idle", "due"),
    [
        (RESYNC_SECONDS - 0.1, 100.0, False),
        (RESYNC_SECONDS, QUIET_SECONDS + 0.1, True),
        (RESYNC_SECONDS, QUIET_SECONDS, False),
        (RESYNC_SECONDS_BUSY - 0.1, 0.0, False),
        (RESYNC_SECONDS_BUSY, 0.0, True),
    ],
)
def test_a_resync_waits_while_plan_follows_plan_but_not_for_ever(resynced: float, idle: float, due: bool) -> None:
    assert resync_is_due(resynced, idle) == due
