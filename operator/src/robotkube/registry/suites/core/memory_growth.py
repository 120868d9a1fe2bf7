"""Growth of containers' memory under traffic, judged by samples of their memory."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.quantities import quantity

SETTLING_SECONDS = 15.0  # at the beginning of a soak: what a process loads under its first messages is no growth
SPAN_SECONDS_MIN = 20.0  # from the first sample that counts to the last one
SAMPLES_MIN = 3
SOAK_SECONDS_MIN = 45  # kubelets measure each container every 10 to 15 s
MEBIBYTE = 1 << 20

Key = tuple[str, str]
"""Pod and container."""


@dataclass(frozen=True)
class MemorySample:
    """The working set of a container, as its kubelet measured it at `seconds` (since 1970)."""

    pod: str
    container: str
    seconds: float
    size_bytes: int

    @property
    def key(self) -> Key:
        """Pod and container."""
        return self.pod, self.container


@dataclass(frozen=True)
class MemoryJudgement:
    """A judgement of memory: `problems` are containers that grew too much; `note` says what was measured, or that
    nothing was and why."""

    problems: tuple[str, ...]
    note: str


def not_measured(reason: str) -> MemoryJudgement:
    """A judgement that claims nothing."""
    return MemoryJudgement((), f"memory: not measured: {reason}")


def memory_limits(pods: Sequence[Mapping[str, Any]]) -> dict[Key, int]:
    """The memory limit of every container in bytes; 0 where there is none."""
    return {
        (str(pod["metadata"]["name"]), str(container.get("name"))): _limit(container)
        for pod in pods
        for container in pod["spec"].get("containers") or ()
    }


def judge_growth(
    samples: Sequence[MemorySample], began: float, limits: Mapping[Key, int], percent: int
) -> MemoryJudgement:
    """Compare the median of the first third of each container's samples with that of the last third; growth beyond
    `percent` of its limit is a problem. `began` (seconds since 1970) is when the traffic began."""
    problems = []
    shares = []
    left_out = []
    for key, limit in sorted(limits.items()):
        sizes = list(_settled(samples, key, began))
        if not limit or not sizes:
            left_out.append(f"{key[1]} of pod {key[0]} ({'too few samples' if limit else 'it has no memory limit'})")
            continue
        third = max(len(sizes) // 3, 1)
        first, last = statistics.median(sizes[:third]), statistics.median(sizes[-third:])
        shares.append(100 * (last - first) / limit)
        if shares[-1] > percent:
            problems.append(
                f"pod {key[0]}: container {key[1]} grew from {first / MEBIBYTE:.0f} to {last / MEBIBYTE:.0f} MiB under "
                f"traffic, by {shares[-1]:.0f} % of its memory limit; the policy allows {percent} %"
            )
    if not shares:
        return not_measured(", ".join(left_out) or "there is no container")
    more = f"; not measured: {', '.join(left_out)}" if left_out else ""
    return MemoryJudgement(tuple(problems), f"memory grew by at most {max(*shares, 0.0):.0f} % of a limit{more}")


def _settled(samples: Sequence[MemorySample], key: Key, began: float) -> Iterator[int]:
    """Sizes of one container after it settled, one for each time of measuring; none when they are too few."""
    sizes = {sample.seconds: sample.size_bytes for sample in samples if sample.key == key}
    times = sorted(seconds for seconds in sizes if seconds >= began + SETTLING_SECONDS)
    if len(times) >= SAMPLES_MIN and times[-1] - times[0] >= SPAN_SECONDS_MIN:
        yield from (sizes[seconds] for seconds in times)


def _limit(container: Mapping[str, Any]) -> int:
    limits = (container.get("resources") or {}).get("limits") or {}
    return int(quantity(limits.get("memory", 0)) or 0)
