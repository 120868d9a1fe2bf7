"""Folders of the repository that tests read."""

from __future__ import annotations

from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[3]
SOURCE = REPOSITORY / "operator" / "src"
CHARTS = REPOSITORY / "charts"
REGISTRY = REPOSITORY / "registry"
DOCS = REPOSITORY / "docs"
SCENARIOS = REPOSITORY / "scenarios"

CHART_PROFILES = REPOSITORY / "operator" / "tests" / "charts" / "profiles"  # values that charts are rendered with
WIDEST = Path(__file__).parent / "platform" / "widest"  # a scenario with every agent that the platform tests need
