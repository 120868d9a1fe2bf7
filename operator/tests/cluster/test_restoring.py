"""What somebody changes past Git comes back as Git says."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from running_platform import Platform, eventually

RESTORED_SECONDS_MAX = 60.0
RELEASE = "mqtt-bridge"


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


@pytest.mark.parametrize(
    "edit",
    [
        '{"spec": {"replicas": 0}}',
        '{"spec": {"template": {"spec": {"containers": [{"name": "mqtt-bridge", "image": "elsewhere.invalid/x:1"}]}}}}',
    ],
    ids=["replicas", "image"],
)
def test_a_deployment_edited_by_hand_is_put_right(platform: Platform, edit: str) -> None:
    before = platform.deployment("vehicle-02", RELEASE)
    platform.kubectl("-n", "vehicle-02", "patch", "deployment", RELEASE, "--patch", edit)
    changed = platform.deployment("vehicle-02", RELEASE)["metadata"]["generation"]
    assert changed > before["metadata"]["generation"]

    def restored() -> bool:
        found = platform.deployment("vehicle-02", RELEASE)
        return found["spec"] == before["spec"] and platform.available("vehicle-02", RELEASE)

    eventually("the edit is undone", restored, RESTORED_SECONDS_MAX)
