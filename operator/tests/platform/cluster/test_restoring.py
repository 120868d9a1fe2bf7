"""What somebody changes past Git comes back as Git says."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from tests.stages.platform.running_platform import Platform, eventually

RESTORED_SECONDS_MAX = 60.0
RELEASE = "mqtt-bridge"
CONTAINER = {"name": RELEASE, "image": "elsewhere.invalid/x:1"}
EDIT = json.dumps({"spec": {"replicas": 0, "template": {"spec": {"containers": [CONTAINER]}}}})


@pytest.fixture(autouse=True)
def undisturbed(platform: Platform) -> Iterator[None]:
    """Each test begins and ends with everything as main asks for."""
    eventually("all Applications synced and healthy", platform.settled)
    yield
    eventually("all Applications synced and healthy", platform.settled)


def test_a_deleted_deployment_comes_back(platform: Platform) -> None:
    before = platform.deployment("vehicle-02", RELEASE)
    platform.kubectl("-n", "vehicle-02", "delete", "deployment", RELEASE, "--wait=false")

    def restored() -> bool:
        found = platform.deployment("vehicle-02", RELEASE)
        other = found and found["metadata"]["uid"] != before["metadata"]["uid"]
        return bool(other) and platform.available("vehicle-02", RELEASE)

    eventually("the Deployment is back", restored, RESTORED_SECONDS_MAX)
    assert platform.deployment("vehicle-02", RELEASE)["spec"] == before["spec"]


def test_a_deployment_edited_by_hand_is_put_right(platform: Platform) -> None:
    """Its replicas and its image, at once."""
    before = platform.deployment("vehicle-02", RELEASE)
    platform.kubectl("-n", "vehicle-02", "patch", "deployment", RELEASE, "--patch", EDIT)
    changed = platform.deployment("vehicle-02", RELEASE)["metadata"]["generation"]
    assert changed > before["metadata"]["generation"]

    def restored() -> bool:
        found = platform.deployment("vehicle-02", RELEASE)
        return found["spec"] == before["spec"] and platform.available("vehicle-02", RELEASE)

    eventually("the edit is undone", restored, RESTORED_SECONDS_MAX)
