"""What the benchmark of the registry measures: this project's registry, with many more versions, without a mistake."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.registry import catalogue
from robotkube.cli import main as cli


def test_its_sources_are_this_projects_with_more_versions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogue, "CHARTS", 2)
    paths = catalogue.sources(tmp_path / "registry")
    more = [path for path in paths if path.parent.name.startswith("chart-")]
    assert len(more) == 2 * catalogue.VERSIONS
    assert len(paths) > len(more)
    assert cli.main(["registry", "validate", "--registry", str(tmp_path / "registry")]) == 0
