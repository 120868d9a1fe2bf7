"""Encounters that overlap, end to end on the real platform: one uplink with two demands, kept until the second ends.
Without their data: test_sharing.py."""

from __future__ import annotations

import pytest

from ci.folders import PROJECT
from tests.stages.platform.running_platform import VARIANT, Platform, spoken
from tests.stages.platform.story import Story, play

pytestmark = pytest.mark.thorough

SCENARIO = PROJECT / "scenarios" / "three-vehicles"


@pytest.fixture(scope="module")
def overlapping(pytestconfig: pytest.Config, platform: Platform, tmp_path_factory: pytest.TempPathFactory) -> Story:
    """The small variant, run once."""
    with spoken(pytestconfig):
        return play(platform, SCENARIO, VARIANT, tmp_path_factory.mktemp("three-vehicles"))


def test_every_expectation_holds(overlapping: Story) -> None:
    """With the bounds of time of the small variant; the scenario's own are the demo's to prove."""
    rows = {row["name"]: row for row in overlapping.report.get("expectations", [])}
    assert {"recordings", "demands_on_shared_release_max", "shared_release_kept", "lost"} <= set(rows), overlapping.talk
    failed = [row for row in rows.values() if not row["passed"]]
    assert failed == [], f"{overlapping.talk[-3000:]}\n{overlapping.output[-3000:]}"
    assert [name for name, row in rows.items() if row["measured"] is None] == []


def test_the_shared_uplink_answers_two_tasks_in_one_commit(overlapping: Story) -> None:
    """The second encounter's plan changes the uplink that the first one's uses; it makes no other one."""
    events = [entry["event"] for entry in overlapping.report["audit"] if entry["event"]]
    assert len(set(" ".join(events).split())) >= 3
    uplinks = [pod for pod in overlapping.of("mqtt-bridge") if pod["metadata"]["namespace"] == "vehicle-01"]
    assert len(uplinks) == 1
