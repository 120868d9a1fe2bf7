"""Images that a plan's values lead to: the gate lets none in that was not verified with its chart, on a real forge."""

from collections.abc import Iterator
from typing import Any

import pytest

from robotkube.registry.charts.adapters.chart_renderer import ChartRenderer
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.loops.release_images import ReleaseImages
from tests.stages.attacks import shown
from tests.stages.forge.installation import ApplicationSetController, Clone, Installation, RunningGate, start_gate
from tests.stages.forge.real_charts import IMAGE, Published, plan_of, published, published_bridge
from tests.stages.programs import program
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

FOREIGN = "docker.io/library/busybox@sha256:" + "2" * 64


@pytest.fixture(scope="module")
def bridge(installation: Installation) -> Iterator[Published]:
    with published_bridge(installation, "0.11.0") as with_image:
        yield with_image


@pytest.fixture
def gate(
    installation: Installation, tmp_path_factory: pytest.TempPathFactory, controller: ApplicationSetController
) -> Iterator[RunningGate]:
    """A gate that renders, as its process does."""
    renderer = ChartRenderer(program("chart-renderer"))
    registry = OciRegistry(installation.url, "gate", installation.passwords["gate"])
    images = ReleaseImages(registry, "verified", renderer)
    running = start_gate(installation, controller.url, tmp_path_factory.mktemp("gate"), images=images)
    yield running
    running.stop()
    registry.disconnect()
    renderer.close()


def propose(installation: Installation, manager: Clone, chart: Published, name: str, values: dict[str, Any]) -> int:
    plan = installation.plan()
    return installation.propose(manager, plan_of(manager, plan, chart, name, values), plan)


def test_a_plan_with_a_foreign_image_is_refused_and_one_with_the_verified_image_is_merged(
    installation: Installation, gate: RunningGate, bridge: Published
) -> None:
    manager = installation.clone("manager")
    foreign = propose(installation, manager, bridge, "bridge-1", {"image": {"reference": FOREIGN}})
    until(lambda: installation.pull_request(foreign)["state"] == "closed", "closed")
    assert not installation.pull_request(foreign)["merged"]
    words = f"spec.values: a pod would run image {FOREIGN}, which was not verified with chart {bridge.chart}"
    said = installation.comments(foreign)
    assert f"{words} (images: {IMAGE})" in said
    shown("gate", said, "image-by-manager")
    verified = propose(installation, manager, bridge, "bridge-2", {"image": {"reference": IMAGE}})
    until(lambda: installation.pull_request(verified)["merged"], "merged")
    default = propose(installation, manager, bridge, "bridge-3", {})
    until(lambda: installation.pull_request(default)["merged"], "merged")
    assert gate.gate.statistics.verdicts["refused"] == 1


def test_a_chart_that_the_oci_registry_does_not_have_is_refused_in_words(
    installation: Installation, gate: RunningGate
) -> None:
    with published(installation, "0.11.1", "sha256:" + "d" * 64) as lost:
        number = propose(installation, installation.clone("manager"), lost, "bridge-4", {})
        until(lambda: installation.pull_request(number)["state"] == "closed", "closed")
    assert f"verified/mqtt-bridge has no chart {lost.chart.digest}" in installation.comments(number)
