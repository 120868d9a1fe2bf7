"""Rounds of the gate while the forge is away: they go on after pauses that grow to a bound and differ."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

from robotkube.delivery.gate.loops.gate import FAILURE_SECONDS_MAX, POLL_SECONDS, Gate
from robotkube.delivery.gate.loops.rules import GateSettings
from robotkube.errors import UnavailableError
from robotkube.testing.forges import MemoryRepository
from tests.stages.pauses import Pauses


class AwayForge:
    """A forge that answers as often as `answers` says, with no pull requests; `now` is when it is asked."""

    def __init__(self, *answers: bool) -> None:
        self.answers = iter(answers)

    def pull_requests(self, state: str) -> list[Any]:
        if not next(self.answers):
            raise UnavailableError("the forge is away")
        return []


class Clock(Pauses):
    """Pauses that pass on a clock."""

    @property
    def now(self) -> float:
        return sum(self.seconds)


def pauses_of(*answers: bool) -> list[float]:
    """The pauses after so many rounds, half of each bound taken after a failure."""
    stopping = threading.Event()
    clock = Clock(len(answers), stopping)
    forge: Any = AwayForge(*answers)
    unused: Any = SimpleNamespace()
    catalogue: Any = SimpleNamespace(catalogue=None, tip="", read=lambda: None)
    settings = GateSettings("gate", "robotkube/deployment", "robotkube/catalogue", (), "oci://forge/verified")
    main: Any = MemoryRepository()
    gate = Gate(forge, main, unused, catalogue, unused, settings, unused, unused, lambda: clock.now, jitter=lambda: 0.5)
    gate._woken = clock
    gate.round = lambda fetch_main=True: forge.pull_requests("open")  # type: ignore[method-assign]
    gate.run(stopping)
    return clock.seconds


def test_a_forge_that_answers_is_polled_by_the_usual_time() -> None:
    assert pauses_of(True, True, True) == [POLL_SECONDS] * 3


def test_every_failed_round_is_tried_again_after_its_own_pause() -> None:
    longest = FAILURE_SECONDS_MAX / 2
    assert pauses_of(False, False, False, True, False) == [POLL_SECONDS / 2, longest, longest, POLL_SECONDS, 1.0]
