"""CPU spent per component, from the control groups: one per daemon of the cluster, one per pod; children are included.

Groups come and go with their pods: each is read every second, and its last value counts.
"""

from __future__ import annotations

import re
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path

from scenarios.runner.inputs import NANOSECONDS, CoresUsed

SAMPLE_SECONDS = 1.0  # a sample of 129 groups takes 8 ms
SAMPLES_MAX = 600  # when there are more, every second one is dropped
REST_SECONDS = 2.0
STOP_SECONDS_MAX = 5.0
POD = re.compile(r"pod([0-9a-f]{8}(?:[-_][0-9a-f]{4}){3}[-_][0-9a-f]{12})(?:\.slice)?$")
PODS = ("*/kubepods/pod*", "*/kubepods/*/pod*", "*/kubepods.slice/*pod*.slice", "*/kubepods.slice/*/*pod*.slice")
DAEMONS = "daemons/*"

PodLabels = Mapping[str, tuple[str, str, Mapping[str, str]]]


class CpuSampler:
    """Reads the groups below `root` (the cluster's folder in the accounting hierarchy) from `start` to `stop`; None:
    nobody counts, and only what this process spends is known."""

    def __init__(self, root: Path | None) -> None:
        self._root = root
        self._first: dict[Path, float] = {}
        self._last: dict[Path, float] = {}
        self._samples: list[tuple[int, dict[Path, float]]] = []
        self._own = 0.0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cpu", daemon=True)

    def start(self) -> None:
        """Takes what was spent before as the zero of every group."""
        self._own = time.process_time()
        self.sample()
        self._first = dict(self._last)
        self._thread.start()

    def stop(self, labels: PodLabels) -> dict[str, float]:
        """Ends; core seconds by component. `labels`: uid -> namespace, name and labels of every pod seen."""
        self._ending.set()
        self._thread.join(STOP_SECONDS_MAX)
        self.sample()
        spent: dict[str, float] = defaultdict(float)
        for folder, seconds in self._last.items():
            spent[component(folder, labels)] += seconds - self._first.get(folder, 0.0)
        spent["scenario (observer, watch)"] = time.process_time() - self._own
        return {name: seconds for name, seconds in sorted(spent.items()) if seconds >= 0.005}

    def cores(self, labels: PodLabels) -> CoresUsed:
        """Cores by component between the samples; one that spent nothing between two has 0 there."""
        used: dict[str, list[float]] = {}
        pairs = list(pairwise(self._samples))
        for number, ((began, before), (ended, after)) in enumerate(pairs):
            seconds = max(ended - began, 1) / NANOSECONDS
            for folder, spent in after.items():
                more = spent - before.get(folder, 0.0)
                if more > 0:
                    name = component(folder, labels)
                    used.setdefault(name, [0.0] * len(pairs))[number] += more / seconds
        return CoresUsed(
            tuple(moment for moment, _ in self._samples), {name: tuple(cores) for name, cores in used.items()}
        )

    def cores_used(self, seconds: float = REST_SECONDS) -> float | None:
        """How many cores the cluster takes, on average over the next `seconds`; None when nobody counts it."""
        if self._root is None:
            return None
        before = usage_seconds(self._root)
        began = time.monotonic()
        time.sleep(seconds)
        after = usage_seconds(self._root)
        return None if before is None or after is None else (after - before) / (time.monotonic() - began)

    def sample(self) -> None:
        """Reads every group that is there now."""
        for folder in self._folders():
            seconds = usage_seconds(folder)
            if seconds is not None:
                self._last[folder] = seconds
        self._samples.append((time.time_ns(), dict(self._last)))
        if len(self._samples) > SAMPLES_MAX:
            del self._samples[1::2]

    def _run(self) -> None:
        while not self._ending.wait(SAMPLE_SECONDS):
            self.sample()

    def _folders(self) -> Iterator[Path]:
        if self._root is not None:
            for pattern in (DAEMONS, *PODS):
                yield from self._root.glob(pattern)


def usage_seconds(folder: Path) -> float | None:
    """CPU time a group has used, of version 1 or 2; None when it is gone."""
    try:
        return int((folder / "cpuacct.usage").read_text()) / 1e9
    except (OSError, ValueError):
        pass
    try:
        values = dict(line.split() for line in (folder / "cpu.stat").read_text().splitlines())
        return int(values["usage_usec"]) / 1e6
    except (OSError, ValueError, KeyError):
        return None


def component(folder: Path, labels: PodLabels) -> str:
    """What a group belongs to: a kind of daemon (one name for all nodes) or a workload of the platform or of agents."""
    pod = POD.search(folder.name)
    if not pod:
        return folder.name.rpartition(".")[2]
    namespace, name, marks = labels.get(pod[1].replace("_", "-"), ("", "", {}))
    if not namespace:
        return "pods not seen by name"
    chart = marks.get("app.kubernetes.io/name", name)
    if not marks.get("robotkube.io/agent"):
        return chart
    release = marks.get("app.kubernetes.io/instance", chart)
    where = namespace.rpartition("-")[0] or namespace
    return f"{'recorder' if release.startswith('recorder-') else chart} ({where})"
