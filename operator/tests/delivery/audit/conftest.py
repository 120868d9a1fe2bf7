"""The platform that audits are tried on, made once; each test that manipulates it gets a copy."""

from pathlib import Path

import pytest

from tests.stages.delivery.audited_platform import Platform, make_platform


@pytest.fixture(scope="package")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Platform:
    """The platform as nobody touched it."""
    return make_platform(tmp_path_factory.mktemp("audited") / "platform")


@pytest.fixture
def platform(clean: Platform, tmp_path: Path) -> Platform:
    """A copy to manipulate."""
    return clean.copy(tmp_path / "platform")
