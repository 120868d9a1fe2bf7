"""Images at selection on a real forge: the manager pulls the chart, renders it, and proposes nothing that the gate
would refuse for its images."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from robotkube.delivery.manager.loops.reconciler import CATALOGUE, TASKS
from robotkube.registry.charts.adapters.chart_renderer import ChartRenderer
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.loops.release_images import ReleaseImages
from robotkube.testing.clusters import MemoryTasks
from tests.stages.delivery.manager.running_manager import RunningManager, start_manager
from tests.stages.forge.installation import Installation, RunningGate
from tests.stages.forge.real_charts import IMAGE, Published, published_bridge
from tests.stages.programs import program
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

FOREIGN = "docker.io/library/busybox@sha256:" + "2" * 64
APPLICATION = "applications/second-bridge.yaml"


def application(version: str) -> str:
    """One whose parameter `image` names the image that a chart of that version runs."""
    service = {
        "name": "bridge",
        "release": "bridge-{{ task.name }}",
        "chart": {"name": "mqtt-bridge", "version": f">={version} <={version}"},
        "placement": {"role": "cloud"},
        "values": {"image": {"reference": "{{ parameters.image }}"}},
    }
    parameters = {"type": "object", "properties": {"image": {"type": "string", "default": IMAGE}}}
    spec = {"description": "Bridges", "provides": [], "parameters": parameters, "services": [service]}
    head = {"apiVersion": "registry.robotkube.io/v1alpha1", "kind": "Application"}
    return yaml.safe_dump({**head, "metadata": {"name": "second-bridge"}, "spec": spec})


@pytest.fixture(scope="module")
def bridge(installation: Installation) -> Iterator[Published]:
    with published_bridge(installation, "0.13.0") as published:
        installation.publish({APPLICATION: application("0.13.0")})
        yield published
    installation.publish({APPLICATION: None})


@pytest.fixture
def manager(
    installation: Installation, bridge: Published, gate: RunningGate, tmp_path: Path
) -> Iterator[RunningManager]:
    registry = OciRegistry(installation.url, "manager", installation.passwords["manager"])
    renderer = ChartRenderer(program("chart-renderer"))
    images = ReleaseImages(registry, "verified", renderer)
    started = start_manager(installation, tmp_path, MemoryTasks(), images=images)
    until(lambda: started.manager.reasons_not_ready() == [], "ready")
    yield started
    started.stop()
    renderer.close()
    registry.disconnect()


def ask(manager: RunningManager, name: str, **parameters: str) -> str:
    event = {"rule": "lidar-proximity", "id": name, "trace": "1e3" + "0" * 29, "time": "2026-11-21T10:00:00Z"}
    spec = {"requester": "cloud-0/event-detector", "event": event, "reason": "a test", "parameters": parameters}
    manager.tasks.create("cloud-0", name, {**spec, "application": "second-bridge"})
    manager.manager.wake(CATALOGUE)
    manager.manager.wake(TASKS)
    return f"cloud-0/{name}"


def test_a_foreign_image_is_refused_with_its_reason_and_no_proposal(
    installation: Installation, manager: RunningManager, bridge: Published
) -> None:
    foreign = ask(manager, "foreign", image=FOREIGN)
    good = ask(manager, "verified")
    until(lambda: manager.tasks.condition(good, "Committed") == ("True", "Merged"), "the verified one is merged")
    until(lambda: manager.tasks.condition(foreign, "Accepted") == ("False", "ImageNotVerified"), "the other is refused")
    message = manager.tasks.objects[foreign]["status"]["conditions"][0]["message"]
    words = f"a pod would run image {FOREIGN}, which was not verified with chart {bridge.chart} (images: {IMAGE})"
    assert message.startswith(f"release cloud-0/bridge-foreign: {words}")
    assert not [plan for plan in manager.plans() if foreign in plan["tasks"]]
    pulls = installation.client("gate").get("/pulls", params={"state": "all", "limit": 50}).json()
    assert not any("foreign" in pull["title"] for pull in pulls)
    assert any("- `cloud-0/foreign` is refused, ImageNotVerified" in pull["body"] for pull in pulls)
