"""Full collections happen between steps, now and then, and set nothing aside for good."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import pytest

from robotkube.foundation.runtime.garbage_collection import Sweeper


class Ring:
    """Garbage that only a collection finds."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture(autouse=True)
def _nothing_set_aside() -> Iterator[None]:
    """Until the test ends: what collecting tests has made is set aside for all others."""
    gc.unfreeze()
    yield
    gc.freeze()


def test_the_first_call_sweeps() -> None:
    ring = Ring()
    found = weakref.ref(ring)
    del ring
    Sweeper(lambda: 100.0)()
    assert found() is None
    assert gc.get_freeze_count() > 0


def test_what_is_set_aside_is_collected_by_the_next_sweep() -> None:
    now = [0.0]
    sweep = Sweeper(lambda: now[0], seconds=60.0)
    ring = Ring()
    found = weakref.ref(ring)
    sweep()
    del ring
    gc.collect()
    assert found() is not None
    now[0] = 59.9
    sweep()
    assert found() is not None
    now[0] = 60.0
    sweep()
    assert found() is None
