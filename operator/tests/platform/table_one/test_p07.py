"""Application updates are conducted by updating the individual container images of an application.

Example: The object detection microservice of an environment perception application is updated independently of other
containers of that application.

Story: A newer version of the detection is published while environment perception runs. One commit changes the
detection's release alone; its pod is a new one, those of the tracking and of all bridges keep their identities.
"""

from __future__ import annotations

from ci import publish
from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import BRIDGE, Stage

DETECTION, TRACKING = "roadside-0/object-detection-roadside-0", "roadside-0/object-tracking-roadside-0"
OLD, NEW = "0.1.2", "0.2.2"
UPDATED_SECONDS_MAX = 120.0


def test_one_service_is_updated_and_the_others_stay(stage: Stage) -> None:
    key = stage.submit(
        "cloud-0", "p07-perception", application="environment-perception", parameters={"sensor": "roadside-0"}
    )
    before = stage.await_running(DETECTION, TRACKING)
    assert {stage.annotation(release, "chart-version") for release in before} == {OLD}
    neighbours = [name for name in stage.releases() if name != DETECTION]
    kept = {name: {pod.uid for pod in stage.pods(name)} for name in neighbours}
    assert any(name.endswith(f"/{BRIDGE}") for name in kept)
    namespace, name = DETECTION.split("/")
    settings = ("-n", namespace, "configmap", name)
    assert "method: size" in stage.platform.get(*settings)["data"]["config.yaml"]
    publish.publish(stage.platform.access.kubeconfig, extra=("object-detection",))

    def updated() -> bool:
        """Version 0.2.2 differs in its settings alone, which its pod watches: it need not be made anew."""
        found, text = stage.pods(DETECTION), stage.platform.get(*settings)["data"]["config.yaml"]
        version = stage.annotation(DETECTION, "chart-version")
        return version == NEW and "method: reflectance" in text and len(found) == 1 and found[0].ready

    eventually("the detection runs in its new version", updated, UPDATED_SECONDS_MAX)
    commit = stage.commit_of(DETECTION)
    assert commit.trailers["Cause"] == ("update",)
    assert [path for path in commit.paths if path.startswith("releases/")] == [f"releases/{DETECTION}.yaml"]
    assert stage.annotation(TRACKING, "chart-version") == OLD
    assert {name: {pod.uid for pod in stage.pods(name)} for name in neighbours} == kept
    assert stage.releases_of(key) == {DETECTION, TRACKING}
