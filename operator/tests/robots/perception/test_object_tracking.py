"""object-tracking: identities over clouds, over gaps, and where two objects pass each other."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import pytest

from robotkube.errors import DocumentError
from robotkube.robots.perception.core.detection import REFLECTANCE, ObjectCriteria, find_objects
from robotkube.robots.perception.core.messages import PlanarPose, Poses, write_poses
from robotkube.robots.perception.core.point_clouds import read_cloud
from robotkube.robots.perception.core.tracking import STEADY, STILL, Tracker, TrackerSettings
from robotkube.robots.perception.core.tracking_settings import read_tracking_settings
from robotkube.robots.perception.loops.object_tracking import ObjectTracking
from robotkube.robots.ros.core.cdr import CdrReader, Header
from scenarios.generator import messages, scene
from tests.stages.bridge.memory_network import Network
from tests.stages.ros import lidar_clouds

PERIOD_NS = 100_000_000
OLDER, NEWER = TrackerSettings(STILL, 2.0, 0.35), TrackerSettings(STEADY, 4.0, 1.0)
DOCUMENT = {"objects": "/v/objects", "tracks": "/v/tracks", "motion": STEADY, "gateMetres": 4, "gapSeconds": 1}


def poses(count: int, places: Sequence[tuple[float, float]]) -> Poses:
    """The objects of cloud number `count`."""
    return Poses(Header(count * PERIOD_NS, "lidar"), tuple(PlanarPose(x, y, 0.0) for x, y in places))


def identities(settings: TrackerSettings, speed: float, unseen: Sequence[int] = ()) -> list[int]:
    """Identity per cloud of one object that drives at `speed` m/s."""
    tracker = Tracker(settings)
    seen = []
    for count in range(1, 40):
        places = [] if count in unseen else [(speed * count / 10, 0.0)]
        seen += [track.id for track in tracker.observe(poses(count, places))]
    return seen


@pytest.mark.parametrize(("settings", "speed"), [(OLDER, 15.0), (NEWER, 30.0)])
def test_one_object_keeps_its_identity(settings: TrackerSettings, speed: float) -> None:
    assert set(identities(settings, speed)) == {1}


def test_a_fast_object_is_lost_by_who_expects_it_where_it_was() -> None:
    assert len(set(identities(OLDER, 30.0))) == 39


def test_gaps_are_bridged_as_long_as_is_promised() -> None:
    nine, ten = range(20, 29), range(20, 31)
    assert set(identities(NEWER, 20.0, nine)) == {1}
    assert set(identities(NEWER, 20.0, ten)) == {1, 2}
    assert set(identities(OLDER, 1.0, range(20, 22))) == {1}
    assert set(identities(OLDER, 1.0, range(20, 24))) == {1, 2}


def test_two_that_pass_each_other_keep_their_identities() -> None:
    tracker = Tracker(NEWER)
    for count in range(1, 60):
        x = -30 + count
        tracks = tracker.observe(poses(count, [(-float(x), 4.0), (float(x), 0.0)]))
        assert {track.id: track.y for track in tracks} == {1: 4.0, 2: 0.0}


def test_objects_found_in_clouds_keep_their_identity() -> None:
    tracker = Tracker(NEWER)
    seen: set[int] = set()
    for count in range(1, 41):
        other = scene.Place(50.0 - 2.5 * count, 4.0, math.pi)
        cloud = read_cloud(lidar_clouds.cloud(other, stamp=count * PERIOD_NS, seed=count))
        objects = find_objects(cloud, ObjectCriteria(REFLECTANCE, 60))
        tracks = tracker.observe(Poses(cloud.header, tuple(one.pose for one in objects)))
        assert len(tracks) == 1
        seen |= {track.id for track in tracks}
    assert seen == {1}


def test_what_is_not_newer_changes_nothing() -> None:
    tracker = Tracker(NEWER)
    first = tracker.observe(poses(5, [(1.0, 1.0)]))
    assert tracker.observe(poses(4, [(50.0, 1.0)])) == first
    assert tracker.observe(poses(5, [(50.0, 1.0)])) == first


def service(**changes: Any) -> tuple[ObjectTracking, Network]:
    network = Network()
    tracking = ObjectTracking(network, lambda *_, **__: None)
    tracking.configure(read_tracking_settings({**DOCUMENT, **changes}, "config.yaml"))
    return tracking, network


def test_every_message_gives_the_tracks_as_text() -> None:
    tracking, network = service()
    for count, places in ((1, []), (2, [(1.0, 2.0)]), (4, [(1.5, 2.0)])):
        observed = poses(count, places)
        network.endpoint("/v/objects").waiting.append(write_poses(observed.header, observed.poses))
    tracking.processor.turn()
    published = network.endpoint("/v/tracks").published
    assert messages.store.deserialize_cdr(published[0], "std_msgs/msg/String").data == CdrReader(published[0]).text()
    documents = [json.loads(CdrReader(data).text()) for data in published]
    assert [document["stamp"] for document in documents] == [PERIOD_NS, 2 * PERIOD_NS, 4 * PERIOD_NS]
    assert [document["tracks"] for document in documents] == [
        [],
        [{"id": 1, "x": 1.0, "y": 2.0, "z": 0.0, "age": 0.0}],
        [{"id": 1, "x": 1.5, "y": 2.0, "z": 0.0, "age": 0.2}],
    ]


def test_other_settings_begin_anew() -> None:
    tracking, network = service()
    for number in (1, 2):
        network.endpoint("/v/objects").waiting.append(write_poses(Header(number, "lidar"), [PlanarPose(0, 0, 0)] * 2))
    tracking.processor.turn()
    tracking.configure(read_tracking_settings({**DOCUMENT, "gapSeconds": 2}, "config.yaml"))
    network.endpoint("/v/objects").waiting.append(write_poses(Header(3, "lidar"), [PlanarPose(0, 0, 0)]))
    tracking.processor.turn()
    tracks = [json.loads(CdrReader(data).text())["tracks"] for data in network.endpoint("/v/tracks").published]
    assert [[track["id"] for track in document] for document in tracks] == [[1, 2], [1, 2], [1]]


def test_what_is_no_pose_array_is_counted() -> None:
    tracking, network = service()
    network.endpoint("/v/objects").waiting.append(b"\0\1\0\0abc")
    tracking.processor.turn()
    assert "tracking_malformed_messages_total 1" in tracking.processor.metrics()
    assert network.endpoint("/v/tracks").published == []


def test_a_type_that_is_not_installed_is_a_complaint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robotkube.robots.perception.loops.object_tracking.POSES_TYPE", "nowhere/msg/Poses")
    tracking, _ = service()
    assert "nowhere" in str(tracking.processor.complaint)


def test_settings_are_refused_with_every_problem() -> None:
    with pytest.raises(DocumentError) as raised:
        read_tracking_settings({**DOCUMENT, "motion": "", "gateMetres": "far", "tracks": "relative"}, "config.yaml")
    for part in ("motion: ''", "gateMetres: 'far' must be", "tracks: 'relative'"):
        assert part in str(raised.value)
