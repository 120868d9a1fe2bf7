"""How much one bridge carries: PoseStamped with QoS 1, one direction at a time, from ROS to the broker and back.

    python3 -m benchmarks.bridges.throughput [--rate 12000] [--seconds 8] [--perf FILE] [--path]

Every process is one of a pod, in network namespaces of two nodes; the load comes at a fixed rate, and every message is
counted at the other end. Needs root, ip, nsenter and mosquitto.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.bridges import processor_time
from benchmarks.bridges.data_path import DataPath
from benchmarks.bridges.processor_time import NaiveBridgePath
from benchmarks.measuring import pods
from benchmarks.measuring.bags import POSE_TYPE
from ci.errors import SetUpError
from ci.machine import preparing

OUT, IN = "out", "in"
AGENT, TOPIC = "vehicle-00", "/vehicles/vehicle_00/pose"
RULES = {"vehicle-00": ["topic readwrite #"]}
RATE, SECONDS = 12_000.0, 8.0
DEPTH = 20_000
POSE_HERTZ = 100
PATH = ("vehicle bridges", "cloud bridge", "broker", "detector input")
START_SECONDS_MAX, DRAIN_SECONDS_MAX = 30.0, 20.0


@dataclass(frozen=True)
class Carried:
    """One direction: messages sent and those that came, messages a second from the first one sent to the last one that
    came, CPU of the bridge per message in us (all its threads), its memory at the end in bytes."""

    direction: str
    sent: int
    received: int
    twice: int
    messages_per_second: float
    core_us_per_message: float
    memory_bytes: int


class BridgeTestbed:
    """Broker, bridge and the two ends of one measurement."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.nodes = pods.Nodes()
        self.broker = pods.Broker(folder / "broker", RULES)
        self.pods: list[pods.Pod] = []
        self.node = -1

    def close(self) -> None:
        """End everything."""
        for pod in self.pods:
            pod.process.terminate()
        for pod in self.pods:
            pod.stop()
        self.broker.stop()
        self.nodes.close()

    def bridge(self, direction: str) -> pods.Pod:
        """The bridge, once it is connected."""
        topic = {"name": TOPIC, "type": POSE_TYPE, "depth": DEPTH}
        settings = self.folder / "config.yaml"
        settings.write_text(json.dumps({"agent": AGENT, direction: [topic]}))
        pod = self._start("bridge", pods.python("robotkube.robots.bridge"), ROBOTKUBE_CONFIG=str(settings))
        log = self.folder / "bridge.log"
        deadline = time.monotonic() + START_SECONDS_MAX
        while '"connected"' not in log.read_text():
            if time.monotonic() > deadline or pod.process.poll() is not None:
                raise SetUpError(f"the bridge does not connect: {log.read_text()}")
            time.sleep(0.05)
        return pod

    def peer(self, role: str, count: int, rate: float) -> pods.Pod:
        """A source or sink; its result goes to a file of its name."""
        options = ["--topic", TOPIC, "--count", str(count), "--rate", str(rate)]
        return self._start(role, pods.python("benchmarks.bridges.peers", role, str(self._result(role)), *options))

    def result(self, role: str, seconds: float) -> dict[str, int] | None:
        """What a peer wrote within that time."""
        path = self._result(role)
        deadline = time.monotonic() + seconds
        while not path.exists():
            if time.monotonic() > deadline:
                return None
            time.sleep(0.02)
        counts: dict[str, int] = json.loads(path.read_text())
        return counts

    def _result(self, role: str) -> Path:
        return self.folder / f"{role}.json"

    def _start(self, name: str, command: list[str], **environment: str) -> pods.Pod:
        if self.node < 0:
            self.broker.start()
            self.node = self.nodes.node()
        variables = {"ROBOTKUBE_SECRETS": str(self.broker.secret(AGENT, self.nodes.gateway(self.node))), **environment}
        place = self.nodes.pod(self.node)
        self.pods.append(pods.start(name, command, variables, self.folder / f"{name}.log", place))
        return self.pods[-1]


def carry(direction: str, rate: float = RATE, seconds: float = SECONDS, perf: Path | None = None) -> Carried:
    """Measure one direction. SetUpError when the ends do not meet."""
    roles = ("ros-source", "mqtt-sink") if direction == OUT else ("mqtt-source", "ros-sink")
    count = int(rate * seconds)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bridge-")))
        folder.chmod(0o755)
        testbed = BridgeTestbed(folder)
        stack.callback(testbed.close)
        sink = testbed.peer(roles[1], count, rate)
        bridge = testbed.bridge(direction)
        before = bridge.cpu_seconds()
        testbed.peer(roles[0], count, rate)
        if perf is not None:
            _record(stack, bridge, perf, seconds)
        received = testbed.result(roles[1], START_SECONDS_MAX + seconds + DRAIN_SECONDS_MAX)
        spent = bridge.cpu_seconds() - before
        memory = bridge.memory_bytes()
        sink.stop()
        received = received or testbed.result(roles[1], 0.0)
        testbed.pods[-1].stop()
        sent = testbed.result(roles[0], 1.0)
        if sent is None or received is None or not received["messages"]:
            raise SetUpError("the ends do not meet: " + "".join(p.read_text()[-2000:] for p in folder.glob("*.log")))
        return _carried(direction, sent, received, spent, memory)


@dataclass(frozen=True)
class PathCosts:
    """CPU per pose in us: bridges of vehicles and cloud, broker and the detector's input; players excluded."""

    ours: float
    naive: float

    @property
    def ratio(self) -> float:
        """What is judged: ours / naive."""
        return self.ours / self.naive


def path_costs() -> PathCosts:
    """Measure the path of a pose from a vehicle's ROS to the detector, ours and as one writes it first, in turn."""
    poses_per_second = processor_time.VEHICLES * POSE_HERTZ
    costs = [processor_time.cpu_percent(kind) for kind in (NaiveBridgePath, DataPath)]
    naive, ours = (sum(cost[part] for part in PATH) * 10_000 / poses_per_second for cost in costs)
    return PathCosts(ours, naive)


def _carried(direction: str, sent: dict[str, int], received: dict[str, int], spent: float, memory: int) -> Carried:
    took = (received["last"] - sent["first"]) / 1e9
    return Carried(
        direction,
        sent["messages"],
        received["messages"],
        received["twice"],
        round(received["messages"] / took, 1),
        round(1e6 * spent / received["messages"], 2),
        memory,
    )


def _record(stack: ExitStack, bridge: pods.Pod, path: Path, seconds: float) -> None:
    command = ["perf", "record", "-g", "-p", str(bridge.process.pid), "-o", str(path), "--", "sleep", str(seconds)]
    perf = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    stack.callback(perf.wait, 30)


def main() -> None:
    """Measure both directions and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=float, default=RATE)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--direction", choices=(OUT, IN), action="append")
    parser.add_argument(
        "--path", action="store_true", help="measure the whole path of a pose instead, beside the naive one"
    )
    parser.add_argument("--perf", type=Path, help="record where the bridge's time goes")
    options = parser.parse_args()
    preparing.for_tests()
    if options.path:
        measured = path_costs()
        print(json.dumps(asdict(measured) | {"ratio": round(measured.ratio, 3)}, indent=1))
        return
    directions: list[Any] = [
        asdict(carry(one, options.rate, options.seconds, options.perf)) for one in options.direction or (OUT, IN)
    ]
    print(json.dumps(directions, indent=1))


if __name__ == "__main__":
    main()
