"""An application is a set of one or several microservices with a particular purpose.

Example: An environment perception application may be composed of two separate microservices for object detection and
object tracking.

Story: One task asks for environment perception with the road-side unit's lidar. One commit makes two releases; a cloud
with a vehicle in it goes in, objects come out of one service and tracks of them out of the other; one commit takes both
away again.
"""

from __future__ import annotations

import json

import numpy as np

from scenarios.definition import cloud_topic
from scenarios.generator import messages, scene
from tests.stages.platform.table_one import POSES, TEXT, Stage

DETECTION, TRACKING = "roadside-0/object-detection-roadside-0", "roadside-0/object-tracking-roadside-0"
PLACE_M = (10.0, 3.0)  # of the other vehicle, ahead and to the left of the sensor's


def cloud() -> bytes:
    """What a lidar on a standing vehicle sees of another one."""
    rays, mount = scene.ray_directions(20_000), scene.Mount(0.0, 0.0, 1.9, 0.0)
    noise = np.zeros(len(rays), np.float32)
    points = scene.cast(rays, mount, scene.Place(0.0, 0.0, 0.0), [scene.Place(*PLACE_M, 0.0)], noise)
    return messages.CloudWriter("roadside_0/lidar_center", len(rays)).message(0, points)


def test_two_services_make_one_application(stage: Stage) -> None:
    key = stage.submit(
        "cloud-0", "p02-perception", application="environment-perception", parameters={"sensor": "roadside-0"}
    )
    pods = stage.await_running(DETECTION, TRACKING)
    assert stage.releases_of(key) == {DETECTION, TRACKING}
    made = stage.commit_of(DETECTION)
    assert made.sha == stage.commit_of(TRACKING).sha
    assert made.trailers["Task"] == (key,)
    assert len({pod.node for pod in pods.values()}) == 1  # their data do not leave the node
    with stage.publishing(TRACKING, (cloud_topic("roadside-0"), messages.CLOUD_TYPE, cloud()), hertz=5):
        [*_, objects] = stage.receive(TRACKING, "/vehicles/roadside_0/objects", POSES, 5)
        [*_, answer] = stage.receive(DETECTION, "/vehicles/roadside_0/tracks", TEXT, 5)
    assert len(objects.poses) == 1
    tracks = json.loads(answer.data)["tracks"]
    assert len({track["id"] for track in tracks}) == 1
    for place in (objects.poses[0].position, tracks[0]):
        x, y = (place["x"], place["y"]) if isinstance(place, dict) else (place.x, place.y)
        assert np.hypot(x - PLACE_M[0], y - PLACE_M[1]) < 3.0
    stage.withdraw(key)
    stage.await_gone(DETECTION, TRACKING)
    removed = stage.commit_of(DETECTION)
    assert removed.sha == stage.commit_of(TRACKING).sha
    assert removed.sha != made.sha
