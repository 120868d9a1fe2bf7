"""The manager in memory, and the platform that is audited, for tests that name them."""

from pathlib import Path

import pytest

from tests.stages.delivery.audit.audited_platform import Platform, make_platform
from tests.stages.delivery.manager.manager_in_memory import Stage


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    """A stage on which the initial configuration is observed."""
    made = Stage(tmp_path)
    made.settle()
    return made


@pytest.fixture(scope="package")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Platform:
    """The platform as nobody touched it."""
    return make_platform(tmp_path_factory.mktemp("audited") / "platform")


@pytest.fixture
def platform(clean: Platform, tmp_path: Path) -> Platform:
    """A copy to manipulate."""
    return clean.copy(tmp_path / "platform")
