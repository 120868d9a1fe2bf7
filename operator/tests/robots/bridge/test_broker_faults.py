"""Two bridges over a real broker that goes away, and settings that change: nothing is lost that need not be, nothing
comes twice, and what was given up is known by number and stamps."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotkube.robots.mqtt.core.message_properties import GAPS_TOPIC, read_gap_text
from robotkube.robots.ros.core.common_messages import string_text
from tests.stages.bridge.two_bridges import Stage, running

pytestmark = pytest.mark.processes

POSE = {"name": "/vehicles/vehicle_00/pose", "type": "geometry_msgs/msg/PoseStamped"}
CLOUD = {"name": "/vehicles/vehicle_00/cloud", "type": "sensor_msgs/msg/PointCloud2", "channel": "bulk"}
OTHER = {**POSE, "name": "/vehicles/vehicle_00/other"}
ANY_POSE = {**POSE, "name": "/vehicles/{agent}/pose"}


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    with running(tmp_path) as made:
        yield made


@pytest.mark.parametrize(
    ("away", "hertz"), [(1.5, 100.0), pytest.param(20.0, 10.0, marks=pytest.mark.thorough)], ids=["short", "20 s"]
)
def test_an_outage_of_the_broker_costs_no_pose_and_every_missing_cloud_is_known(
    stage: Stage, away: float, hertz: float
) -> None:
    topics = ((POSE, 100.0), (CLOUD, hertz))
    stage.vehicle.configure(out=[POSE, CLOUD])
    stage.cloud.configure(**{"in": [POSE, CLOUD]}, publish_gaps=True)
    stage.ready()
    stage.play(1.0, *topics)
    stage.restart_broker(away, *topics)
    stage.play(8.0, *topics)
    for topic in (POSE, CLOUD):
        stage.drained(topic)
    assert stage.received(POSE) == list(range(stage.sent[POSE["name"]]))
    clouds = stage.received(CLOUD)
    missing = sorted(set(range(stage.sent[CLOUD["name"]])) - set(clouds))
    assert clouds == sorted(set(clouds))
    assert len(missing) > away * hertz / 2
    gaps = [read_gap_text(string_text(one).decode()) for one in stage.cloud.network.endpoint(GAPS_TOPIC).published]
    assert sorted(number for gap in gaps for number in range(gap.first, gap.last + 1)) == missing
    assert sum(gap.count or 0 for gap in gaps) == len(missing)
    assert {(gap.topic, gap.where) for gap in gaps} == {(CLOUD["name"], "mqtt-bridge of vehicle-00")}


def test_a_connection_that_breaks_loses_and_doubles_nothing(stage: Stage) -> None:
    stage.vehicle.configure(out=[POSE])
    stage.cloud.configure(**{"in": [POSE]})
    stage.ready()
    for side in (stage.vehicle, stage.cloud, stage.vehicle):
        stage.play(0.5, (POSE, 400.0))
        stage.connection_of(side).shutdown(socket.SHUT_RDWR)
    stage.play(2.0, (POSE, 400.0))
    stage.drained(POSE)
    assert stage.received(POSE) == list(range(stage.sent[POSE["name"]]))
    assert 'connections_total{channel="telemetry"} 3' in stage.vehicle.bridge.metrics()


def test_a_topic_that_stays_loses_nothing_when_settings_change(stage: Stage) -> None:
    stage.vehicle.configure(out=[POSE])
    stage.cloud.configure(**{"in": [POSE]})
    stage.ready()
    stage.play(0.4, (POSE, 400.0))
    sink = stage.cloud.endpoint(POSE)
    for out, into in (
        ([POSE, CLOUD], [POSE, CLOUD]),
        ([POSE, OTHER], [POSE, ANY_POSE, OTHER]),
        ([POSE], [POSE, ANY_POSE]),
        ([POSE, CLOUD], [POSE]),
        ([POSE], [POSE]),
    ):
        stage.cloud.configure(**{"in": into})
        stage.vehicle.configure(out=out)
        stage.play(0.4, (POSE, 400.0))
    stage.drained(POSE)
    assert stage.received(POSE) == list(range(stage.sent[POSE["name"]]))
    assert stage.cloud.endpoint(POSE) is sink


def test_a_topic_of_any_agent_loses_nothing_from_its_first_message_on(stage: Stage) -> None:
    stage.vehicle.configure(out=[POSE])
    stage.cloud.configure(**{"in": [ANY_POSE]})
    stage.ready()
    stage.play(0.5, (POSE, 400.0))
    stage.drained(POSE)
    stage.restart_broker(0.5, (POSE, 400.0))
    stage.play(2.0, (POSE, 400.0))
    stage.drained(POSE)
    assert stage.received(POSE) == list(range(stage.sent[POSE["name"]]))
    assert stage.vehicle.bridge.not_carried == stage.cloud.bridge.not_carried == []
