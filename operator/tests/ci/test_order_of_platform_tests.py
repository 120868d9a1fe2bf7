"""In what order tests on the shared platform run: who takes that away comes after all who need it."""

from __future__ import annotations

from pathlib import Path

from tests import platform
from tests.platform.conftest import ORDER

TAKING_IT_AWAY = ".down()"


def test_modules_with_clusters_of_their_own_come_last() -> None:
    """But the first, which starts before there is a shared one."""
    folder = Path(platform.__file__).parent
    taking = [name for name in ORDER[1:] if TAKING_IT_AWAY in (folder / f"{name}.py").read_text(encoding="utf-8")]
    assert len(taking) > 1
    assert list(ORDER[-len(taking) :]) == taking
