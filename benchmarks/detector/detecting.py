"""What the event detector's input costs: CPU per pose, messages a second on one core, time from a message to its event.

    python3 -m benchmarks.detector.detecting [receive] [sustained] [latency]

The detector is the process of a pod with a proximity rule over 15 vehicles, in a network namespace of its own; poses
come from another pod of the same node by the network. Needs root, ip and nsenter.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.measuring import pods
from benchmarks.measuring.bags import CLOUD_TYPE, POSE_TYPE
from benchmarks.measuring.comparisons import quantiles
from ci.errors import SetUpError
from ci.machine import preparing
from robotkube.robots.detector.adapters.ros_topics import KNOWN_SECONDS

AGENTS = 15
DEMO_RATE = 1500.0
SUSTAINED_RATE = 16_000.0
SECONDS = 20.0
SWING = 5
"""An edge per pair every 5 messages: 140 edges a second at 15 x 100 Hz."""
START_SECONDS_MAX, END_SECONDS_MAX = 60.0, 20.0
SETTLE_SECONDS = KNOWN_SECONDS + 1
"""Until then a new subscription remembers what came; what a pose costs is measured afterwards."""
PORT = 8081


class Received(NamedTuple):
    """CPU of the whole process per pose, of the detector and of a process that only takes."""

    us_per_message: float
    baseline_us_per_message: float
    messages: int


class Sustained(NamedTuple):
    """Messages a second that one core took, from the first to the last one sent, and those that never came. No more
    come than the source sends; `core_fraction`: how much of the core the detector's process took for them."""

    messages_per_second_one_core: float
    lost: int
    core_fraction: float


class Latency(NamedTuple):
    """From the reception of a message by the middleware to its event: ms, and how many events."""

    p99_ms: float
    p50_ms: float
    n: int


def settings(agents: int, clouds: bool = False) -> dict[str, Any]:
    """The detector's settings: who is within 400 m of whom; with `clouds` it buffers 10 s of everything."""
    pattern = "/vehicles/{agent}/pose"
    rule = {
        "name": "near",
        "kind": "proximity",
        "agents": [f"vehicle-{number:02d}" for number in range(agents)],
        "topic": pattern,
        "start_distance_m": 400,
        "stop_distance_m": 500,
    }
    topics: list[dict[str, Any]] = [{"name": pattern, "type": POSE_TYPE, "depth": 20_000}]
    if clouds:
        topics.append({"name": "/vehicles/{agent}/lidar_center/pointcloud", "type": CLOUD_TYPE, "depth": 10})
        for topic in topics:
            topic["buffer"] = {"seconds": 10, "bytes": 50_000_000}
    return {"name": "cloud-0/event-detector", "topics": topics, "rules": [rule]}


@dataclass
class DetectorTestbed:
    """Two pods on a node."""

    folder: Path
    nodes: pods.Nodes
    node: int
    namespaces: list[str]
    started: list[pods.Pod]

    def start(self, role: str, *options: str, core: int | None = None, **environment: str) -> pods.Pod:
        """A role of `peers` in a namespace of its own; with `core` on that core alone."""
        self.namespaces.append(self.nodes.pod(self.node))
        command = pods.python("benchmarks.detector.peers", role, str(self.result_path(role)), *options)
        pinned = ["taskset", "-c", str(core), *command] if core is not None else command
        log = self.folder / f"{role}.log"
        self.started.append(pods.start(role, pinned, environment, log, self.namespaces[-1]))
        return self.started[-1]

    def stop(self) -> None:
        """End everything."""
        for pod in self.started:
            pod.stop()

    def detector(self, core: int | None = None, clouds: bool = False) -> pods.Pod:
        """The detector's process."""
        path = self.folder / "config.yaml"
        path.write_text(json.dumps(settings(AGENTS, clouds)))
        return self.start("detector", core=core, ROBOTKUBE_CONFIG=str(path), ROBOTKUBE_HEALTH_PORT=str(PORT))

    def received(self) -> int:
        """Messages that the detector has counted."""
        url = f"http://127.0.0.1:{PORT}/input"
        reading = f"import urllib.request as u;print(u.urlopen('{url}', timeout=5).read().decode())"
        command = ["nsenter", f"--net=/run/netns/{self.namespaces[0]}", *pods.python("json")[:1], "-c", reading]
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True)
        return sum(topic["received"] for topic in json.loads(done.stdout)["topics"].values())

    def result_path(self, role: str) -> Path:
        """The file to which a role writes its result."""
        return self.folder / f"{role}.json"

    def wait(self, role: str, seconds: float) -> Any:
        """A role's result; SetUpError when it does not come."""
        path = self.result_path(role)
        deadline = time.monotonic() + seconds
        while not path.exists() or not path.read_text():
            if time.monotonic() > deadline:
                logs = "".join(log.read_text()[-2000:] for log in self.folder.glob("*.log"))
                raise SetUpError(f"{role} has no result after {seconds:.0f} s: {logs}")
            time.sleep(0.1)
        return json.loads(path.read_text())


@contextmanager
def testbed() -> Iterator[DetectorTestbed]:
    """A node; everything on it is taken away afterwards."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="detecting-")))
        folder.chmod(0o755)
        nodes = pods.Nodes()
        stack.callback(nodes.close)
        made = DetectorTestbed(folder, nodes, nodes.node(), [], [])
        stack.callback(made.stop)
        yield made


def receive(seconds: float = SECONDS) -> Received:
    """At the demo's rate, 15 x 100 Hz."""
    with testbed() as here:
        drained = here.start("drain", "--agents", str(AGENTS))
        play(here, seconds, DEMO_RATE)
        drained.stop()
        result = here.wait("drain", END_SECONDS_MAX)
        baseline = 1e6 * result["cpu_seconds"] / result["messages"]
    with testbed() as here:
        detector = here.detector()
        source = _begin(here, SETTLE_SECONDS + seconds, DEMO_RATE)
        time.sleep(SETTLE_SECONDS)
        before = here.received()
        spent = detector.cpu_seconds()
        time.sleep(seconds - 4)
        spent, messages = detector.cpu_seconds() - spent, here.received() - before
        source.stop()
    return Received(round(1e6 * spent / messages, 2), round(baseline, 2), messages)


def sustained(rate: float = SUSTAINED_RATE, seconds: float = SECONDS) -> Sustained:
    """The detector alone on the last core."""
    cores = sorted(os.sched_getaffinity(0))
    with testbed() as here:
        detector = here.detector(core=cores[-1])
        before = detector.cpu_seconds()  # the start counts, too: a few hundredths
        sent = play(here, seconds, rate, core=cores[0])
        deadline = time.monotonic() + END_SECONDS_MAX
        while (received := here.received()) < sent["messages"] and time.monotonic() < deadline:
            time.sleep(0.2)
        spent = detector.cpu_seconds() - before
    took = (sent["last"] - sent["first"]) / 1e9
    return Sustained(round(received / took, 1), sent["messages"] - received, round(spent / took, 3))


def latency(n: int = 1000) -> Latency:
    """At least `n` events at the demo's rate."""
    seconds = 3 + n / (AGENTS // 2 * DEMO_RATE / AGENTS / SWING)
    with testbed() as here:
        detector = here.detector()
        play(here, seconds, DEMO_RATE, swing=SWING)
        detector.stop()
        nanoseconds: Sequence[int] = here.wait("detector", END_SECONDS_MAX)["latencies_ns"]
    if len(nanoseconds) < n:
        raise SetUpError(f"{len(nanoseconds)} events instead of {n}")
    milliseconds = quantiles([value / 1e6 for value in nanoseconds])
    return Latency(milliseconds.p99, milliseconds.p50, milliseconds.n)


def memory(minutes: int) -> list[int]:
    """Resident bytes of the detector after each minute at the paper's full rate: 15 poses at 100 Hz, two clouds of
    320 kB at 10 Hz, 10 s of everything in the buffers, an edge per pair every 5 poses."""
    sizes = []
    with testbed() as here:
        detector = here.detector(clouds=True)
        _begin(here, 60.0 * minutes + 5, DEMO_RATE, swing=SWING, clouds=2)
        began = time.monotonic()
        for minute in range(1, minutes + 1):
            time.sleep(max(0.0, began + 60 * minute - time.monotonic()))
            sizes.append(detector.memory_bytes())
    return sizes


def _begin(
    here: DetectorTestbed, seconds: float, rate: float, swing: int = 0, core: int | None = None, clouds: int = 0
) -> pods.Pod:
    """Start the source and wait until poses flow."""
    options = ["--agents", str(AGENTS), "--rate", str(rate), "--count", str(int(rate * seconds)), "--swing", str(swing)]
    options += ["--clouds", str(clouds)]
    source = here.start("source", *options, core=core)
    if here.started[0].component != "detector":
        return source
    deadline = time.monotonic() + START_SECONDS_MAX
    while not _flowing(here):
        if time.monotonic() > deadline or here.started[0].process.poll() is not None:
            raise SetUpError("no poses: " + "".join(log.read_text()[-2000:] for log in here.folder.glob("*.log")))
        time.sleep(0.2)
    return source


def _flowing(here: DetectorTestbed) -> bool:
    try:
        return here.received() > 0
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
        return False


def play(here: DetectorTestbed, seconds: float, rate: float, swing: int = 0, core: int | None = None) -> Any:
    """Have all poses published; what the source says of it."""
    _begin(here, seconds, rate, swing, core)
    return here.wait("source", START_SECONDS_MAX + 2 * seconds)


MEASUREMENTS: dict[str, Callable[[], Received | Sustained | Latency]] = {
    "receive": receive,
    "sustained": sustained,
    "latency": latency,
}


def main() -> None:
    """Measure and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("measurements", nargs="*")
    options = parser.parse_args()
    preparing.for_tests()
    results = {name: MEASUREMENTS[name]()._asdict() for name in options.measurements or MEASUREMENTS}
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
