"""What the whole path of a pose costs, from the vehicle's ROS to a rule in the cloud: both bridges, the broker and the
detector, against the path one would write first (facts of `naive_bridge` and `naive_detector`). Players and what counts
the messages are left out; they are the same on both sides.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from benchmarks.bridges.data_path import DataPath, measure_lossless
from benchmarks.detector.detecting import settings
from benchmarks.measuring import pods

VEHICLES, SECONDS, HERTZ = 3, 14.0, 100
COUNTED = ("vehicle bridges", "broker", "cloud bridge", "detector")
NAIVE = {"robotkube.robots.bridge": "benchmarks.bridges.naive_bridge"}


class WholePath(NamedTuple):
    """Processor time per pose in us, all components together and each."""

    us_per_message: float
    components: dict[str, float]


class WholeDataPath(DataPath):
    """The data path with a detector beside what counts."""

    detector = "robotkube.robots.detector"

    def _receiver(self, node: int) -> None:
        super()._receiver(node)
        self._launch("detector", node, "cloud-0", "event-detector", self.detector, settings(len(self.agents)))


class NaiveDataPath(WholeDataPath):
    """The vehicles, the cloud and the detector as one would write them first."""

    detector = "benchmarks.detector.naive_detector"

    def _launch(self, component: str, node: int, agent: str, name: str, module: str, *rest: Any) -> pods.Pod:
        return super()._launch(component, node, agent, name, NAIVE.get(module, module), *rest)


def cost(kind: type[WholeDataPath]) -> WholePath:
    """Measure one side; SetUpError when poses were lost, since then the numbers say nothing."""
    measured = measure_lossless(lambda folder: kind(folder, VEHICLES, 0, SECONDS), kind.__name__)
    each = {one: round(measured["cpu_percent"][one] * 1e4 / (VEHICLES * HERTZ), 1) for one in COUNTED}
    return WholePath(round(sum(each.values()), 1), each)
