"""The console's page in a browser, on the running platform: fleet, why, and what would become of a task."""

from __future__ import annotations

from ci import console
from ci.folders import PROJECT
from tests.stages.platform.running_platform import Platform

PICTURES = PROJECT / "build" / "console" / "platform"


def test_a_way_through_fleet_why_and_tasks(platform: Platform) -> None:
    vehicle = next(agent for agent in platform.agents if agent.startswith("vehicle-"))
    asked = ("pose-point-cloud-recording", f"vehicles={vehicle}")
    service = platform.installer.console()
    assert service is not None
    said = console.browse("smoke", f"http://{service.address}:{service.port}/", vehicle, *asked, str(PICTURES))
    assert "fleet, why and tasks are as they should be" in said
