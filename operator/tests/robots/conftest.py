"""Processes of detectors and publishers; reactions that do not wait long for what a test has ready."""

import pytest

from robotkube.robots.reactions.loops import deliveries, operator
from tests.stages.detector.fixtures import api, start, unused_port  # noqa: F401 - fixtures

SHORT_SECONDS = 0.02


@pytest.fixture(autouse=True)
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of reactions in this process: how often they look at their clock when there is nothing to do."""
    monkeypatch.setattr(deliveries, "WAIT_SECONDS", SHORT_SECONDS)
    monkeypatch.setattr(operator, "WAIT_SECONDS", SHORT_SECONDS)
