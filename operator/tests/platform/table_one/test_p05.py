"""Each microservice is packaged into its own container.

Example: Two microservices of an environment perception application, object detection and object tracking, are
separately packaged into their own containers.

Story: Environment perception runs as two pods of one container each, from two charts that main names by two digests;
one of the containers is ended, and the other does not notice.

Asserted: on the pods, one container each and every image by a digest; on main, two charts with two digests; on the
pods' identities, that one is another pod afterwards and the other the same.
"""

from __future__ import annotations

from tests.stages.platform.roadside_perception import DETECTION, TRACKING, RoadsidePerception


def test_each_service_has_a_container_of_its_own(perception: RoadsidePerception) -> None:
    pods = perception.pods
    assert {release: len(pod.images) for release, pod in pods.items()} == {DETECTION: 1, TRACKING: 1}
    assert all("@sha256:" in image for pod in pods.values() for image in pod.images)
    assert perception.charts == {DETECTION: "object-detection", TRACKING: "object-tracking"}
    assert len(set(perception.digests.values())) == 2


def test_the_end_of_one_container_is_not_noticed_by_the_other(perception: RoadsidePerception) -> None:
    assert [pod.uid for pod in perception.tracking_after] == [perception.pods[TRACKING].uid]
