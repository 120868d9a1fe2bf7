"""What several of the ten stories tell of, played once, and the results of all of them, for the docs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ci.reference.principles import RESULTS
from tests.stages.platform import roadside_perception, three_operators
from tests.stages.platform.roadside_perception import RoadsidePerception
from tests.stages.platform.running_platform import Platform
from tests.stages.platform.table_one import on_stage
from tests.stages.platform.three_operators import ThreeOperators

outcomes: dict[str, str] = {}


@pytest.fixture(scope="session")
def perception(platform: Platform) -> RoadsidePerception:
    """Environment perception on the road-side unit, from its task to its withdrawal."""
    with on_stage(platform) as stage:
        return roadside_perception.play(stage)


@pytest.fixture(scope="session")
def operators(platform: Platform) -> ThreeOperators:
    """Operators in cloud, on edge server and vehicle, from a person's pull request until nothing is left."""
    with on_stage(platform) as stage:
        return three_operators.play(stage)


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
