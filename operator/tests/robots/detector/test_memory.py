"""What the detector's process holds while messages come at the paper's full rate, for ten minutes."""

from __future__ import annotations

import pytest

from benchmarks.detector import detecting

pytestmark = pytest.mark.processes

MINUTES = 10
GROWTH_BYTES_MAX = 16 * 2**20


@pytest.mark.thorough
def test_ten_minutes_at_full_rate_keep_the_memory_of_the_process() -> None:
    resident = detecting.memory(MINUTES)
    assert len(resident) == MINUTES
    assert min(resident) > 2 * 10 * 10 * 320_000, "the buffers hold ten seconds of two vehicles' clouds"
    assert resident[-1] - resident[1] <= GROWTH_BYTES_MAX, [round(held / 2**20, 1) for held in resident]
