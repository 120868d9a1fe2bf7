"""`helm lint --strict` has nothing to say about any chart, as it lies there and with the values of its profiles, and
every value says what it is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.stages.paths import CHARTS
from tests.stages.registry import wrong_interfaces
from tests.stages.registry.publications import write_sources

pytestmark = pytest.mark.toolchain
PROFILES = Path(__file__).parent / "profiles"
EVERY_CHART = sorted(str(path.parent.relative_to(CHARTS)) for path in CHARTS.glob("**/Chart.yaml"))
EARLIER = [chart for chart in EVERY_CHART if chart.startswith("earlier/") and "robotkube-app" not in chart]
PLATFORM = CHARTS / "robotkube"
PLATFORM_PROFILES = {
    "official": [PROFILES / "official.yaml"],
    "managers": [PROFILES / "official.yaml", PROFILES / "managers.yaml"],
    "embedded": [PLATFORM / "values-embedded.yaml", PROFILES / "embedded.yaml"],
}


def lint(helm: Any, chart: Path, *files: Path) -> str:
    """What helm says when it finds a mistake, empty when it finds none."""
    done = helm.run("lint", "--strict", str(chart), *(option for file in files for option in ("-f", str(file))))
    assert "1 chart(s) linted" in done.stdout + done.stderr
    return "" if done.returncode == 0 else str(done.stdout)


def profile(chart: str) -> Path | None:
    """The values file of an application chart; earlier versions have some of their own. None for a library."""
    places = [PROFILES / Path(chart).parent.name / f"{Path(chart).name}.yaml", PROFILES / f"{Path(chart).name}.yaml"]
    return next((place for place in places if place.exists()), None)


def test_every_chart_is_seen() -> None:
    assert {"robotkube", "apps/robotkube-app", "earlier/robotkube-app", "apps/bag-player"} <= set(EVERY_CHART)
    assert len(EVERY_CHART) >= 12
    assert [chart for chart in EVERY_CHART if profile(chart) is None] == [
        "apps/robotkube-app",
        "earlier/robotkube-app",
        "robotkube",
    ]


# What was published stays as it was, and its schema wants values.
@pytest.mark.parametrize("chart", [chart for chart in EVERY_CHART if chart not in EARLIER])
def test_a_chart_passes_as_it_is(helm: Any, chart: str) -> None:
    assert lint(helm, CHARTS / chart) == ""


@pytest.mark.parametrize("chart", [chart for chart in EVERY_CHART if profile(chart)])
def test_a_chart_passes_with_the_values_of_a_release(helm: Any, chart: str) -> None:
    values = profile(chart)
    assert values is not None
    assert lint(helm, CHARTS / chart, values) == ""


@pytest.mark.parametrize("name", PLATFORM_PROFILES)
def test_the_platform_passes_with_each_of_its_profiles(helm: Any, name: str) -> None:
    assert lint(helm, PLATFORM, *PLATFORM_PROFILES[name]) == ""


def test_what_registry_new_makes_passes(helm: Any, tmp_path: Path) -> None:
    chart, _ = wrong_interfaces.write_chart("text-relay", {}, tmp_path)
    assert lint(helm, chart) == ""
    assert lint(helm, chart, helm.values({"placement": {"agent": "vehicle-00"}})) == ""


@pytest.mark.parametrize("service", ["order", "plan", "drive"])
def test_every_chart_of_a_new_chain_passes(helm: Any, tmp_path: Path, service: str) -> None:
    write_sources(tmp_path, "delivery", "--services", "order,plan,drive")
    chart = tmp_path / "charts" / "apps" / f"delivery-{service}"
    assert lint(helm, chart) == ""
    assert lint(helm, chart, helm.values({"placement": {"agent": "vehicle-00"}})) == ""


def test_a_mistake_is_found(helm: Any, tmp_path: Path) -> None:
    chart, _ = wrong_interfaces.write_chart("text-relay", {}, tmp_path)
    (chart / "templates" / "wrong.yaml").write_text("kind: {{ .Values.nothing.there }}\n")
    assert "nil pointer evaluating" in lint(helm, chart)


def test_every_value_has_prose() -> None:
    def silent(schema: Any, path: str) -> list[str]:
        if not isinstance(schema, dict):
            return []
        undescribed = []
        for key, value in schema.get("properties", {}).items():
            described = "description" in value or "$ref" in value or "enum" in value or set(value) <= {"type"}
            undescribed += [] if described else [f"{path}.{key}"]
            undescribed += silent(value, f"{path}.{key}")
        return undescribed + silent(schema.get("items"), f"{path}[]")

    for schema in CHARTS.glob("**/values.schema.json"):
        if not schema.parent.is_symlink():
            assert silent(json.loads(schema.read_text()), schema.parent.name) == []
