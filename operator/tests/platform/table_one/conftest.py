"""The results of the ten stories, for the docs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ci.principles import RESULTS

outcomes: dict[str, str] = {}


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Notes what became of each principle: its worst phase counts, and one failed test fails it."""
    if "table_one/test_p" not in report.nodeid:
        return
    name = Path(report.nodeid.partition("::")[0]).stem.removeprefix("test_")
    if report.failed or outcomes.get(name) == "failed":
        outcomes[name] = "failed"
    elif report.when == "call":
        outcomes[name] = report.outcome


def pytest_sessionfinish() -> None:
    """Writes the results, if any of the stories ran."""
    if outcomes:
        RESULTS.parent.mkdir(parents=True, exist_ok=True)
        RESULTS.write_text(json.dumps(outcomes, indent=2, sort_keys=True) + "\n", encoding="utf-8")
