"""The running platform of the cluster tests, a stage on it, and the results of the ten stories for the docs."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "cluster"))

from running_platform import Platform, shared, stop_demo, take_down
from stage import Stage, on_stage

from ci.principles import RESULTS

HERE = Path(__file__).parent
outcomes: dict[str, str] = {}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """In the order of the table."""
    for item in items:
        if item.path.parent == HERE:
            item.add_marker(pytest.mark.cluster)


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


@pytest.fixture(scope="session")
def platform(pytestconfig: pytest.Config) -> Iterator[Platform]:
    """The platform that the cluster tests use, too; brought up here when they did not run."""
    stop_demo(pytestconfig)
    yield shared(pytestconfig)
    take_down()


@pytest.fixture
def stage(platform: Platform) -> Iterator[Stage]:
    """Begins with everything as main asks for, and ends with main asking for what it did before."""
    with on_stage(platform) as stage:
        yield stage
