"""Each microservice is packaged into its own container.

Example: Two microservices of an environment perception application, object detection and object tracking, are
separately packaged into their own containers.

Story: Environment perception runs as two pods of one container each, from two charts that main names by two digests;
one of the containers is ended, and the other does not notice.
"""

from __future__ import annotations

from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import Stage

DETECTION, TRACKING = "roadside-0/object-detection-roadside-0", "roadside-0/object-tracking-roadside-0"


def test_each_service_has_a_container_of_its_own(stage: Stage) -> None:
    stage.submit("cloud-0", "p05-perception", application="environment-perception", parameters={"sensor": "roadside-0"})
    pods = stage.await_running(DETECTION, TRACKING)
    assert {release: len(pod.images) for release, pod in pods.items()} == {DETECTION: 1, TRACKING: 1}
    assert all("@sha256:" in image for pod in pods.values() for image in pod.images)
    charts = {release: stage.annotation(release, "chart") for release in pods}
    assert charts == {DETECTION: "object-detection", TRACKING: "object-tracking"}
    assert len({stage.annotation(release, "chart-digest") for release in pods}) == 2
    stage.platform.kubectl("-n", "roadside-0", "delete", "pod", pods[DETECTION].name, "--grace-period=0", "--force")

    def replaced() -> bool:
        found = stage.pods(DETECTION)
        return len(found) == 1 and found[0].ready and found[0].uid != pods[DETECTION].uid

    eventually("another container of the detection runs", replaced)
    assert [pod.uid for pod in stage.pods(TRACKING)] == [pods[TRACKING].uid]
