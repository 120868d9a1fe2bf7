"""Takes samples of pods' memory beside a soak, and has them judged."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from robotkube.errors import InputError, RobotKubeError
from robotkube.registry.suites.core import memory_growth
from robotkube.registry.suites.core.memory_growth import MemoryJudgement, MemorySample
from robotkube.registry.suites.ports.suites import MemoryReader, Object

SAMPLE_SECONDS = 5.0  # kubelets measure every 10 to 15 s: what was read twice counts once
STOP_SECONDS_MAX = 10.0


@dataclass(frozen=True)
class MemoryWatch:
    """What is measured in a soak: `percent` of its limit that a container may grow; `now` is the wall clock in seconds
    since 1970."""

    reader: MemoryReader
    percent: int
    now: Callable[[], float]
    pause_seconds: float = SAMPLE_SECONDS

    def beside(self, pods: Sequence[Object], seconds: int, soak: Callable[[], int]) -> tuple[int, MemoryJudgement]:
        """The result of `soak`, which sends for `seconds`, and what became of the pods' memory meanwhile."""
        if seconds < memory_growth.SOAK_SECONDS_MIN:
            words = f"{seconds} s are too short to claim anything, at least {memory_growth.SOAK_SECONDS_MIN} are needed"
            return soak(), memory_growth.not_measured(words)
        sampling = _Sampling(self, pods)
        began = self.now()
        sampling.thread.start()
        try:
            result = soak()
        finally:
            sampling.stop()
        return result, sampling.judgement(began)


class _Sampling:
    """One soak's samples, taken on a thread of their own, and why the last try gave none."""

    def __init__(self, watch: MemoryWatch, pods: Sequence[Object]) -> None:
        self._watch = watch
        self._pods = pods
        self._samples: list[MemorySample] = []
        self._problem = ""
        self._over = threading.Event()
        self.thread = threading.Thread(target=self._run, daemon=True)

    def stop(self) -> None:
        """Take no more."""
        self._over.set()
        self.thread.join(STOP_SECONDS_MAX)

    def judgement(self, began: float) -> MemoryJudgement:
        """Of what was sampled since `began`."""
        samples = list(self._samples)
        if not samples:
            return memory_growth.not_measured(self._problem or "the kubelet has no numbers of these pods")
        limits = memory_growth.memory_limits(self._pods)
        return memory_growth.judge_growth(samples, began, limits, self._watch.percent)

    def _run(self) -> None:
        while not self._over.is_set():
            try:
                self._samples += self._watch.reader.read(self._pods)
            except RobotKubeError as error:
                self._problem = str(error)
                if isinstance(error, InputError):
                    return  # refused: asking again changes nothing
            self._over.wait(self._watch.pause_seconds)
