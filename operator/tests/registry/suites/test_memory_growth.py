"""Growth of memory under traffic: judged when there is enough to judge by, and not claimed otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.errors import UnavailableError
from robotkube.registry.suites.core.memory_growth import MemorySample, judge_growth, memory_limits
from robotkube.registry.suites.loops.installed.memory_sampling import MemoryWatch

LIMITS = {("pod", "main"): 100 << 20}
BEGAN = 1000.0


def samples(*sizes: int, first: float = 20.0, step: float = 10.0) -> list[MemorySample]:
    return [MemorySample("pod", "main", BEGAN + first + step * index, size << 20) for index, size in enumerate(sizes)]


@pytest.mark.parametrize(
    ("sizes", "percent"),
    [((50, 50, 50), 0), ((50, 55, 60), 10), ((60, 55, 50), 0), ((50, 90, 51), 1), ((50, 50, 99, 50, 51, 50), 0)],
)
def test_what_stays_within_its_share_passes(sizes: Sequence[int], percent: int) -> None:
    judged = judge_growth(samples(*sizes), BEGAN, LIMITS, 10)
    assert (judged.problems, judged.note) == ((), f"memory grew by at most {percent} % of a limit")


def test_what_grows_beyond_its_share_is_named() -> None:
    judged = judge_growth(samples(50, 52, 55, 58, 61, 64), BEGAN, LIMITS, 10)
    assert judged.problems == (
        "pod pod: container main grew from 51 to 62 MiB under traffic, by 12 % of its memory limit; "
        "the policy allows 10 %",
    )


def test_what_a_process_takes_while_it_settles_is_no_growth() -> None:
    early = samples(1, 10, first=0.0, step=7.0)
    assert judge_growth([*early, *samples(50, 50, 50)], BEGAN, LIMITS, 10).problems == ()


@pytest.mark.parametrize(
    ("given", "limits", "words"),
    [
        (samples(1, 99), LIMITS, "main of pod pod (too few samples)"),
        (samples(1, 50, 99, step=5.0), LIMITS, "main of pod pod (too few samples)"),
        (samples(1, 1, 1)[:1] * 9, LIMITS, "main of pod pod (too few samples)"),
        (samples(1, 50, 99), {("pod", "main"): 0}, "main of pod pod (it has no memory limit)"),
        ([], {}, "there is no container"),
    ],
)
def test_what_cannot_be_judged_is_not_claimed(given: Any, limits: Any, words: str) -> None:
    judged = judge_growth(given, BEGAN, limits, 10)
    assert (judged.problems, judged.note) == ((), f"memory: not measured: {words}")


def test_a_container_that_is_not_measured_is_named_beside_those_that_are() -> None:
    note = judge_growth(samples(50, 50, 50), BEGAN, {**LIMITS, ("pod", "side"): 0}, 10).note
    assert note.endswith("0 % of a limit; not measured: side of pod pod (it has no memory limit)")


def test_limits_are_those_of_the_pods() -> None:
    containers = [{"name": "main", "resources": {"limits": {"memory": "64Mi"}}}, {"name": "side"}]
    pods = [{"metadata": {"name": "pod"}, "spec": {"containers": containers}}]
    assert memory_limits(pods) == {("pod", "main"): 64 << 20, ("pod", "side"): 0}


class Away:
    """A kubelet that does not answer at first."""

    def __init__(self, answers: int) -> None:
        self.asked = 0
        self.answers = answers

    def read(self, pods: Sequence[Mapping[str, Any]]) -> Sequence[MemorySample]:
        self.asked += 1
        if self.asked > self.answers:
            raise UnavailableError("kubelet at 10.0.0.1:10250: timed out")
        return samples(50, 50, 50)


def test_a_kubelet_that_never_answers_is_said() -> None:
    result, judged = MemoryWatch(Away(0), 10, lambda: BEGAN).beside([], 60, lambda: 3)
    assert (result, judged.note) == (3, "memory: not measured: kubelet at 10.0.0.1:10250: timed out")


def test_a_soak_that_fails_ends_the_sampling() -> None:
    reader = Away(1)

    def fail() -> int:
        raise UnavailableError("the run's time is over")

    with pytest.raises(UnavailableError, match="time is over"):
        MemoryWatch(reader, 10, lambda: BEGAN).beside([], 60, fail)
    assert reader.asked <= 1
