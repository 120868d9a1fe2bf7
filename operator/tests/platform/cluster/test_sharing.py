"""One uplink for two demands stays, in the same pod, when the first ends. With their data: test_three_vehicles.py."""

from __future__ import annotations

import yaml

from scenarios.definition import cloud_topic
from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import Stage

UPLINK = "vehicle-01/mqtt-bridge"
FIRST, SECOND = ("vehicle-00", "vehicle-01"), ("vehicle-01", "vehicle-02")


def recording(stage: Stage, *vehicles: str) -> str:
    """Asks for a recording of what these vehicles see."""
    parameters = {"vehicles": list(vehicles)}
    return stage.submit(
        "cloud-0", f"shared-{vehicles[0]}", application="pose-point-cloud-recording", parameters=parameters
    )


def sends(stage: Stage) -> list[str]:
    """Topics that the pod of the shared uplink is told to send."""
    settings = stage.platform.get("-n", "vehicle-01", "configmap", "mqtt-bridge")["data"]["config.yaml"]
    return [topic["name"] for topic in yaml.safe_load(settings)["out"]]


def test_an_uplink_with_two_demands_outlives_the_first(stage: Stage) -> None:
    topic = cloud_topic("vehicle-01")
    before = stage.await_running(UPLINK)[UPLINK]
    first, second = recording(stage, *FIRST), recording(stage, *SECOND)
    eventually("the uplink names both", lambda: {first, second} <= set(stage.annotation(UPLINK, "tasks").split()))
    stage.await_running("cloud-0/recorder-vehicle-01-vehicle-02")
    eventually("the uplink sends what both want, once", lambda: sends(stage).count(topic) == 1)
    stage.withdraw(first)
    stage.await_gone("cloud-0/recorder-vehicle-00-vehicle-01")
    assert stage.annotation(UPLINK, "tasks").split() == [second]
    assert sends(stage).count(topic) == 1
    stage.withdraw(second)
    eventually("the uplink sends it no more", lambda: topic not in sends(stage))
    assert [pod.uid for pod in stage.pods(UPLINK)] == [before.uid]
