"""The test values in the catalogue's sources fit the charts they are for, and lead to topics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.registry.catalogue.core.chart_versions import read_chart_version
from robotkube.registry.catalogue.core.expected_topics import declaration_checks, expected_topics
from robotkube.registry.charts.core.values_schemas import overlay
from robotkube.registry.suites.loops.installation import filled_sets
from tests.stages.paths import REPOSITORY

ENTRIES = sorted((REPOSITORY / "registry" / "charts").glob("*/*.yaml"))
render = Jinja2Templates().render


def loaded(path: Path) -> dict[str, Any]:
    return dict(yaml.safe_load(path.read_text(encoding="utf-8")))


def folder_of(entry: Path) -> Path:
    """The chart of this version; older versions have folders of their own."""
    folders = [path.parent for path in REPOSITORY.glob(f"charts/*/{entry.parent.name}/Chart.yaml")]
    [match] = [folder for folder in folders if loaded(folder / "Chart.yaml")["version"] == entry.stem]
    return match


@pytest.mark.parametrize("path", ENTRIES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_sets_fit_the_charts_schema_and_give_different_topics(path: Path) -> None:
    chart = folder_of(path)
    version = read_chart_version(path.read_text(), f"charts/{path.parent.name}/{path.name}", published=False)
    schema = json.loads((chart / "values.schema.json").read_text())
    sets = filled_sets(loaded(path), "cloud-0", 1_763_750_000_000_000_000, render)
    assert len(sets) == 2
    topics = {}
    for test_set in sets:
        values = overlay(loaded(chart / "values.yaml"), test_set.values)
        assert list(validate(schema, values)) == [], test_set.name
        assert values["placement"]["agent"] == "cloud-0"
        topics[test_set.name] = expected_topics(version.interfaces, values, render)
        assert topics[test_set.name], test_set.name
    assert [check for check in declaration_checks(version.interfaces, topics) if not check.passed] == []


def test_the_player_is_ordered_a_run_as_it_reads_one() -> None:
    (first, second) = filled_sets(loaded(REPOSITORY / "registry/charts/bag-player/0.1.3.yaml"), "cloud-0", 42, render)
    assert (first.config_maps, second.config_maps) == (
        {"simulation": {"run": "suite-first", "start": "42"}},
        {"simulation": {"run": "suite-second", "start": "42"}},
    )
    assert first.prepare_command[-1].removeprefix("/var/lib/robotkube/scratch") == "/suite-a"
    assert first.values["player"]["bag"].removeprefix("/var/lib/robotkube/bags") == "/suite-a"
