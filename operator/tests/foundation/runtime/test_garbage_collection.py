"""Full collections happen between steps, now and then, and set nothing aside for good."""

from __future__ import annotations

import subprocess
import sys

import pytest

BEGINNING = """
import gc
import weakref
from robotkube.foundation.runtime.garbage_collection import Sweeper


class Ring:  # garbage that only a collection finds
    def __init__(self):
        self.itself = self


ring = Ring()
found = weakref.ref(ring)
"""
FIRST_CALL = """
del ring
Sweeper(lambda: 100.0)()
assert found() is None
assert gc.get_freeze_count() > 0
"""
NEXT_SWEEP = """
now = [0.0]
sweep = Sweeper(lambda: now[0], seconds=60.0)
sweep()
del ring
gc.collect()
assert found() is not None, "it was not set aside"
now[0] = 59.9
sweep()
assert found() is not None, "it came before its time"
now[0] = 60.0
sweep()
assert found() is None
"""


@pytest.mark.parametrize("rest", [FIRST_CALL, NEXT_SWEEP], ids=["the first call sweeps", "the next sweep finds it"])
def test_what_is_garbage_goes_with_a_sweep(rest: str) -> None:
    """In a process of its own: a sweep of this one goes through all tests that were collected."""
    ended = subprocess.run([sys.executable, "-c", BEGINNING + rest], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
