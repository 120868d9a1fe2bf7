"""The order in which tests on the shared platform run: who takes that away comes after all who need it."""

from __future__ import annotations

from pathlib import Path

from tests import platform
from tests.platform.conftest import ORDER

TAKING_IT_AWAY = ("bare_platform import", ".down()", "cluster_of_others import", "remove_running(", "node_engine(")


def test_modules_with_clusters_of_their_own_come_last() -> None:
    """But the first, which starts before there is a shared one."""
    folder = Path(platform.__file__).parent
    texts = {name: (folder / f"{name}.py").read_text(encoding="utf-8") for name in ORDER[1:]}
    taking = [name for name, text in texts.items() if any(words in text for words in TAKING_IT_AWAY)]
    assert len(taking) > 1
    assert list(ORDER[-len(taking) :]) == taking
