"""The healthy run that tests break, and the manager in memory."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.stages.delivery.fixtures import stage  # noqa: F401 - a fixture
from tests.stages.scenarios import healthy_run


@pytest.fixture
def run(tmp_path: Path) -> healthy_run.Run:
    """A run that passes."""
    return healthy_run.healthy(tmp_path)
