"""Bridges of two vehicles over a broker with the rights of main: a topic goes to the other one when main says so."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.measuring.bags import message
from robotkube.robots.ros.core.common_messages import header_stamp
from tests.stages.attacks import shown
from tests.stages.bridge.two_bridges import Side
from tests.stages.delivery.rights.kept_rights import KeptRights
from tests.stages.delivery.rights.main_of_links import POSE_00, bridge
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

POSE = {"name": POSE_00, "type": "geometry_msgs/msg/PoseStamped"}
LINK = bridge("vehicle-01", POSE)


@pytest.fixture
def rights(tmp_path: Path) -> Iterator[KeptRights]:
    made = KeptRights(tmp_path / "broker")
    made.ready()
    yield made
    made.end()
    made.broker.stop()


class Pair:
    """The bridges of a vehicle that says its pose, and of one that is to hear it."""

    def __init__(self, rights: KeptRights) -> None:
        broker: Any = rights.broker
        self.speaker, self.listener = Side(broker, "vehicle-00"), Side(broker, "vehicle-01")
        self.speaker.configure(out=[POSE])
        self.listener.configure(**{"in": [POSE]})
        self.sent = 0

    def turn(self) -> None:
        for side in (self.speaker, self.listener):
            side.bridge.turn(time.monotonic())

    def say(self) -> None:
        self.speaker.endpoint(POSE).waiting.append(message(self.sent, self.sent, 200))
        self.sent += 1
        self.turn()

    def heard(self) -> list[int]:
        self.turn()
        return [header_stamp(data) for data in self.listener.endpoint(POSE).published]

    def refused(self) -> bool:
        self.turn()
        return bool(self.listener.bridge.not_carried)

    def close(self) -> None:
        for side in (self.speaker, self.listener):
            side.bridge.close()


def test_a_link_from_vehicle_to_vehicle(rights: KeptRights) -> None:
    """Also where the right comes later than the bridge, which says until then what is refused, and heals by itself."""
    pair = Pair(rights)
    until(pair.refused, "it is said that the topic is refused")
    [sentence] = pair.listener.bridge.not_carried
    assert sentence.startswith(f"mqtt{POSE_00}: ")
    shown("elsewhere", sentence, "heard-without-a-link")
    rights.merge(LINK)
    until(lambda: not pair.refused(), "the bridge has asked again")
    first = pair.sent
    for _ in range(20):
        pair.say()
    until(lambda: pair.heard()[-1:] == [pair.sent - 1], "the last one")
    assert [number for number in pair.heard() if number >= first] == list(range(first, pair.sent))
    heard = pair.heard()
    rights.merge()
    for _ in range(5):
        pair.say()
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        pair.turn()
    assert pair.heard() == heard
    assert pair.listener.bridge.complaint is None
    pair.close()
