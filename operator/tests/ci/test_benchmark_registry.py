"""What the benchmark of the registry measures: this project's registry, with many more versions, without a mistake."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import registry
from robotkube.cli import main as cli


def test_its_sources_are_this_projects_with_more_versions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "CHARTS", 2)
    paths = registry.sources(tmp_path / "registry")
    more = [path for path in paths if path.parent.name.startswith("chart-")]
    assert len(more) == 2 * registry.VERSIONS
    assert len(paths) > len(more)
    assert cli.main(["registry", "validate", "--registry", str(tmp_path / "registry")]) == 0
