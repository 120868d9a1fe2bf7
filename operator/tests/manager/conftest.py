"""The manager in memory, for its tests."""

from pathlib import Path

import pytest
from manager_stage import Stage


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    """After the initial configuration is observed."""
    found = Stage(tmp_path)
    found.settle()
    return found
