"""CPU of the bridges for the poses of a few vehicles: ours, which carries what 40 ms brought in one batch, against the
one of `naive_bridge`. Everything else (players, broker, the cloud's bridge, the receiver) is the same.
"""

from __future__ import annotations

from typing import Any

from benchmarks.bridges.data_path import DataPath, measure_lossless
from benchmarks.measuring import pods
from benchmarks.measuring.comparisons import Comparison

VEHICLES, SECONDS = 3, 14.0
OURS = "robotkube.robots.bridge"
# component -> its name in the table, and what our CPU / the baseline's may be
COMPONENTS = {"vehicle bridges": ("bridges of the vehicles", 0.6), "broker": ("broker", 0.9)}


class NaiveBridgePath(DataPath):
    """The vehicles run the naive bridge."""

    def _launch(self, component: str, node: int, agent: str, name: str, module: str, *rest: Any) -> pods.Pod:
        if component == "vehicle bridges":
            module = "benchmarks.bridges.naive_bridge"
        return super()._launch(component, node, agent, name, module, *rest)


def cpu_percent(kind: type[DataPath]) -> dict[str, float]:
    """CPU of each component in % of one core; SetUpError when poses were lost, since then the numbers say nothing."""
    return dict(measure_lossless(lambda folder: kind(folder, VEHICLES, 0, SECONDS), kind.__name__)["cpu_percent"])


def compare() -> list[Comparison]:
    """The vehicles' bridges are what differs; the broker has fewer messages to carry."""
    naive, ours = cpu_percent(NaiveBridgePath), cpu_percent(DataPath)
    baseline = "executor, a message each"
    return [
        Comparison(f"{text}, {VEHICLES} x 100 Hz", "% CPU", ours[component], naive[component], ratio_max, baseline)
        for component, (text, ratio_max) in COMPONENTS.items()
    ]
