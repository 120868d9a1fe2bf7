"""What somebody changes past Git comes back as Git says. What the API server refuses to be changed:
registry/admission/test_policies_api_server.py."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.stages.platform.running_platform import Platform, eventually

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
        deployment = platform.deployment("vehicle-02", RELEASE)
        other = deployment and deployment["metadata"]["uid"] != before["metadata"]["uid"]
        return bool(other) and platform.available("vehicle-02", RELEASE)

    eventually("the Deployment is back", restored, RESTORED_SECONDS_MAX)
    assert platform.deployment("vehicle-02", RELEASE)["spec"] == before["spec"]


def test_a_deployment_scaled_by_hand_is_put_right(platform: Platform) -> None:
    """Which an administrator may, also under admission."""
    before = platform.deployment("vehicle-02", RELEASE)
    platform.kubectl("-n", "vehicle-02", "scale", "deployment", RELEASE, "--replicas=0")
    changed = platform.deployment("vehicle-02", RELEASE)["metadata"]["generation"]
    assert changed > before["metadata"]["generation"]

    def restored() -> bool:
        deployment = platform.deployment("vehicle-02", RELEASE)
        return deployment["spec"] == before["spec"] and platform.available("vehicle-02", RELEASE)

    eventually("the release runs again", restored, RESTORED_SECONDS_MAX)
