"""Images of a release: its chart by digest, rendered with its values and its plan."""

from collections.abc import Mapping
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.registry.charts.core.packing import PulledChart
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.loops.release_images import CHARTS_KEPT_MAX, ReleaseImages, ReleaseObjects

CHART = ChartReference("app", "0.1.0", "sha256:" + "1" * 64)


class Registry:
    """Charts whose one file is their repository and digest; `pulled` counts."""

    def __init__(self) -> None:
        self.pulled: list[str] = []
        self.absent: set[str] = set()

    def manifest_digest(self, repository: str, reference: str) -> str | None:
        return None if repository in self.absent else reference

    def pull_chart(self, repository: str, digest: str) -> PulledChart:
        self.pulled.append(f"{repository}@{digest}")
        if len(self.pulled) == 1 and digest.endswith("9"):
            raise UnavailableError("the OCI registry is away")
        return PulledChart({}, {"Chart.yaml": f"{repository}@{digest}".encode()}, b"", b"")


class Program:
    """Renders one pod that runs what its values say; keeps what it was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[Mapping[str, bytes], Mapping[str, Any], str, str]] = []

    def render(
        self, files: Mapping[str, bytes], values: Mapping[str, Any], release: str, namespace: str
    ) -> list[dict[str, Any]]:
        self.asked.append((files, values, release, namespace))
        if "broken" in values:
            raise InputError("the chart cannot be rendered: no")
        return [{"kind": "Pod", "spec": {"containers": [{"image": values["image"]}]}}]


def images_of(registry: Registry, program: Program) -> ReleaseImages:
    return ReleaseImages(registry, "verified", program)  # type: ignore[arg-type]  # of the registry one method is used


def test_a_chart_is_pulled_by_digest_and_rendered_as_it_is_deployed() -> None:
    registry = Registry()
    program = Program()
    assert images_of(registry, program)(CHART, {"image": "x"}, "plan-1", "app-1", "cloud-0") == ("x",)
    files, values, release, namespace = program.asked[0]
    assert files == {"Chart.yaml": f"verified/app@{CHART.digest}".encode()}
    assert values == {"image": "x", "global": {"plan": "plan-1"}}
    assert (release, namespace) == ("app-1", "cloud-0")


def test_files_are_kept_and_renderings_are_not() -> None:
    registry = Registry()
    program = Program()
    images = images_of(registry, program)
    assert images(CHART, {"image": "x"}, "p", "a", "n") == ("x",)
    assert images(CHART, {"image": "y"}, "p", "a", "n") == ("y",)
    assert len(registry.pulled) == 1
    for number in range(CHARTS_KEPT_MAX):
        images(ChartReference("app", "0.1.0", f"sha256:{number}0"), {"image": "x"}, "p", "a", "n")
    images(CHART, {"image": "x"}, "p", "a", "n")
    assert len(registry.pulled) == CHARTS_KEPT_MAX + 2


def test_what_cannot_be_rendered_or_pulled_is_said_and_not_remembered() -> None:
    registry = Registry()
    program = Program()
    images = images_of(registry, program)
    away = ChartReference("app", "0.1.0", "sha256:" + "9" * 64)
    with pytest.raises(UnavailableError):
        images(away, {"image": "x"}, "p", "a", "n")
    assert images(away, {"image": "x"}, "p", "a", "n") == ("x",)
    with pytest.raises(InputError, match="cannot be rendered"):
        images(CHART, {"broken": True}, "p", "a", "n")


def test_a_chart_comes_from_the_first_place_that_has_it() -> None:
    registry = Registry()
    program = Program()
    objects = ReleaseObjects(registry, ("verified", "staging"), program)  # type: ignore[arg-type]  # as above
    assert objects(CHART, {"image": "x"}, "p", "a", "n")[0]["kind"] == "Pod"
    registry.absent = {"verified/other"}
    objects(ChartReference("other", "0.1.0", CHART.digest), {"image": "x"}, "p", "a", "n")
    assert [place.partition("@")[0] for place in registry.pulled] == ["verified/app", "staging/other"]
