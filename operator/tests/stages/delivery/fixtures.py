"""The manager in memory, for its tests."""

from pathlib import Path

import pytest

from tests.stages.delivery.manager_in_memory import Stage


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    """After the initial configuration is observed."""
    made = Stage(tmp_path)
    made.settle()
    return made
