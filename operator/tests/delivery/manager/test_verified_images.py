"""Images at selection: what would run an image that was not verified with its chart is refused before a proposal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.manager.loops.reconciler import CATALOGUE, TASKS
from robotkube.delivery.manager.loops.verified_images import RELEASES_KEPT_MAX, VerifiedImages
from robotkube.errors import InputError, UnavailableError
from robotkube.registry.charts.core.packing import PulledChart
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.loops.release_images import ReleaseImages
from tests.stages.attacks import shown
from tests.stages.delivery.manager.manager_in_memory import Stage

IMAGE, FOREIGN = "forge:3000/ros@sha256:" + "3" * 64, "elsewhere:5000/miner@sha256:" + "4" * 64
RECORDER = "cloud-0/recorder-vehicle-00-vehicle-01"


@dataclass
class Images:
    """What releases would run: IMAGE, but for the releases (by name) in `of`; `asked` are all questions."""

    of: dict[str, Any] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)

    def __call__(
        self, chart: ChartReference, values: Mapping[str, Any], plan: str, release: str, namespace: str
    ) -> Sequence[str]:
        self.asked.append(f"{namespace}/{release}")
        image = self.of.get(release, IMAGE)
        if callable(image):
            image = image(values)
        if isinstance(image, Exception):
            raise image
        return (image,)


@pytest.fixture
def images() -> Images:
    return Images()


@pytest.fixture
def stage(tmp_path: Path, images: Images) -> Stage:
    """A manager that has merged its initial configuration, with a catalogue whose charts run one image."""
    stage = Stage(tmp_path, image=IMAGE, images=images)
    stage.settle()
    assert len(stage.forge.pulls) == 1
    return stage


def accepted(stage: Stage, key: str) -> tuple[str, str, str]:
    condition = next(c for c in stage.tasks.objects[key]["status"]["conditions"] if c["type"] == "Accepted")
    return condition["status"], condition["reason"], condition["message"]


def test_only_what_a_plan_changes_is_rendered_and_once(stage: Stage, images: Images) -> None:
    initial = sorted(images.asked)
    assert initial == sorted({f"{r.namespace}/{r.name}" for r in stage.releases().values()})
    images.asked.clear()
    key = stage.ask()
    stage.go()
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")
    bridges = {"cloud-0/mqtt-bridge", "vehicle-00/mqtt-bridge", "vehicle-01/mqtt-bridge"}
    assert set(images.asked) == {RECORDER, *bridges}
    assert len(images.asked) == len(set(images.asked))
    images.asked.clear()
    stage.tasks.delete(key)
    stage.go()
    assert RECORDER not in {f"{r.namespace}/{r.name}" for r in stage.releases().values()}
    assert images.asked == []  # the bridges are as they were before


def test_a_task_that_leads_to_a_foreign_image_is_refused_and_nothing_is_proposed(stage: Stage, images: Images) -> None:
    images.of["recorder-vehicle-00-vehicle-01"] = FOREIGN
    before = stage.releases()
    key = stage.ask()
    stage.go()
    status, reason, message = accepted(stage, key)
    assert (status, reason) == ("False", "ImageNotVerified")
    assert message.startswith(
        f"release {RECORDER}: a pod would run image {FOREIGN}, which was not verified with chart "
    )
    assert f"(images: {IMAGE})" in message
    shown("selection", message, "image-by-publisher")
    assert stage.tasks.reports == [(key, "ImageNotVerified", message)]
    assert len(stage.forge.pulls) == 1
    assert stage.releases() == before


class Charts:
    """An OCI registry with one chart, and a program that renders a pod with an image as a volume of it."""

    def pull_chart(self, repository: str, digest: str) -> PulledChart:
        return PulledChart({}, {"Chart.yaml": b""}, b"", b"")

    def render(
        self, files: Mapping[str, bytes], values: Mapping[str, Any], release: str, namespace: str
    ) -> list[dict[str, Any]]:
        image = FOREIGN if release.startswith("recorder") else IMAGE
        volume = {"name": "model", "image": {"reference": image}}
        return [{"kind": "Pod", "spec": {"containers": [{"image": IMAGE}], "volumes": [volume]}}]


def test_an_image_that_is_a_volume_is_refused_as_well(tmp_path: Path) -> None:
    charts: Any = Charts()
    stage = Stage(tmp_path, image=IMAGE, images=ReleaseImages(charts, "verified", charts))
    stage.settle()
    key = stage.ask()
    stage.go()
    status, reason, message = accepted(stage, key)
    assert (status, reason) == ("False", "ImageNotVerified")
    shown("selection", message, "image-volume")


def test_others_go_on_in_the_same_step(stage: Stage, images: Images) -> None:
    images.of["recorder-vehicle-00-vehicle-01"] = FOREIGN
    bad, good = stage.ask("bad"), stage.ask("good", ("vehicle-00", "vehicle-02"))
    stage.manager.wake(TASKS)
    stage.manager.step()
    assert len(stage.forge.pulls) == 2
    stage.go()
    assert accepted(stage, bad)[1] == "ImageNotVerified"
    assert stage.tasks.condition(good, "Committed") == ("True", "Merged")


def test_it_stays_refused_without_being_rendered_again_until_its_inputs_change(stage: Stage, images: Images) -> None:
    images.of["recorder-vehicle-00-vehicle-01"] = FOREIGN
    key = stage.ask()
    stage.go()
    images.asked.clear()
    stage.go(10)
    assert (accepted(stage, key)[1], images.asked) == ("ImageNotVerified", [])
    path = "charts/event-detector/0.2.3.yaml"
    stage.publish_again("event-detector", "0.2.3", [IMAGE, FOREIGN])
    assert path in stage.catalogue.trees[stage.catalogue.tip]
    stage.go(wake=CATALOGUE)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_what_a_running_task_shares_is_not_taken_from_it_by_one_that_spoils_it(stage: Stage, images: Images) -> None:
    def spoilt(values: Mapping[str, Any]) -> str:
        return FOREIGN if "vehicle_02" in str(values) else IMAGE

    first = stage.ask("first")
    stage.go()
    assert stage.tasks.condition(first, "Committed") == ("True", "Merged")
    before = stage.releases()
    images.of["mqtt-bridge"] = spoilt
    second = stage.ask("second", ("vehicle-00", "vehicle-02"))
    stage.go()
    assert accepted(stage, second)[1] == "ImageNotVerified"
    assert stage.tasks.condition(first, "Accepted")[0] == "True"
    assert stage.releases() == before


def test_the_initial_configuration_goes_on_without_the_one_that_leads_elsewhere(
    tmp_path: Path, images: Images, caplog: pytest.LogCaptureFixture
) -> None:
    images.of["event-detector"] = FOREIGN
    stage = Stage(tmp_path, image=IMAGE, images=images)
    stage.settle()
    names = {release.name for release in stage.releases().values()}
    assert "event-detector" not in names
    assert "mqtt-bridge" in names
    assert "demands refused for their images demands=1 first=initial/proximity-operator/cloud-0" in caplog.text
    key = stage.ask()
    stage.go()
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_what_runs_stays_when_it_would_be_changed_to_a_foreign_image(stage: Stage, images: Images) -> None:
    key = stage.ask()
    stage.go()
    before = stage.releases()
    images.of["recorder-vehicle-00-vehicle-01"] = FOREIGN
    path = "applications/pose-point-cloud-recording.yaml"
    text = stage.catalogue.trees[stage.catalogue.tip][path]
    stage.catalogue.push({path: text.replace("bytes: 1000000}", "bytes: 2000000}")})
    stage.go(wake=CATALOGUE)
    assert accepted(stage, key)[1] == "ImageNotVerified"
    assert stage.releases() == before


def test_a_chart_that_cannot_be_rendered_is_refused_and_one_that_cannot_be_tried_is_left_to_the_gate(
    stage: Stage, images: Images, caplog: pytest.LogCaptureFixture
) -> None:
    images.of["recorder-vehicle-00-vehicle-01"] = InputError("the chart cannot be rendered: no")
    bad = stage.ask()
    stage.go()
    assert accepted(stage, bad)[1] == "ImageNotVerified"
    assert accepted(stage, bad)[2].startswith(f"release {RECORDER}: the chart cannot be rendered: no. The task stays")
    images.of["recorder-vehicle-00-vehicle-02"] = UnavailableError("the OCI registry is away")
    key = stage.ask("other", ("vehicle-00", "vehicle-02"))
    stage.go()
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")
    assert "images not looked up, the gate does reason='the OCI registry is away'" in caplog.text


def test_an_explanation_says_so_before_anybody_asks(stage: Stage, images: Images) -> None:
    images.of["recorder-vehicle-00-vehicle-01"] = FOREIGN
    key = stage.ask()
    document = stage.tasks.objects[key]
    stage.tasks.delete(key)
    explained = stage.manager.what_if(document)
    assert any("is refused, ImageNotVerified" in line for line in explained.lines)
    assert explained.changes == ()


def test_without_a_renderer_the_gate_alone_looks(tmp_path: Path) -> None:
    stage = Stage(tmp_path, image=IMAGE)
    stage.settle()
    key = stage.ask()
    stage.go()
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_what_is_remembered_is_bounded() -> None:
    assert RELEASES_KEPT_MAX <= 10_000
    assert VerifiedImages(None).problems((), None) == {}  # type: ignore[arg-type]  # nothing is looked up there
