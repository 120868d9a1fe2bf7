"""An application is a set of one or several microservices with a particular purpose.

Example: An environment perception application may be composed of two separate microservices for object detection and
object tracking.

Story: One task asks for environment perception with the road-side unit's lidar. One commit makes two releases; a cloud
with a vehicle in it goes in, objects come out of one service and tracks of them out of the other; one commit takes both
away again.

Asserted: on main, that one commit has both releases and another one takes both away, with the task in its trailers; on
the pods, that both run on one Node; on messages that are received in pods: objects where the vehicle stands in the
cloud that was published beside them, and a track of one identity.
"""

from __future__ import annotations

import numpy as np

from tests.stages.platform.roadside_perception import DETECTION, PLACE_M, TRACKING, RoadsidePerception


def test_two_services_make_one_application(perception: RoadsidePerception) -> None:
    assert perception.releases == {DETECTION, TRACKING}
    made, removed = perception.made[DETECTION], perception.removed[DETECTION]
    assert made.sha == perception.made[TRACKING].sha
    assert made.trailers["Task"] == (perception.task,)
    assert len({pod.node for pod in perception.pods.values()}) == 1  # their data do not leave the node
    assert removed.sha == perception.removed[TRACKING].sha
    assert removed.sha != made.sha


def test_objects_come_out_of_one_service_and_their_tracks_out_of_the_other(perception: RoadsidePerception) -> None:
    [object_pose] = perception.objects.poses
    assert len({track["id"] for track in perception.tracks}) == 1
    for x, y in (
        (object_pose.position.x, object_pose.position.y),
        (perception.tracks[0]["x"], perception.tracks[0]["y"]),
    ):
        assert np.hypot(x - PLACE_M[0], y - PLACE_M[1]) < 3.0
