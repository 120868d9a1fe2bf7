"""A narrow uplink: the age of poses while clouds ask for more than twice of it, with kinds of traffic and without.

    python3 -m benchmarks.bridges.narrow_uplink [--mbit 20] [--seconds 20] [--congestion cubic] [--only kinds]

The vehicle's player and bridge stand in one network namespace, whose way out is a token bucket (`tc ... tbf`) with the
deep queue of a modem, and TCP as Linux has it. The age is that at a ROS subscription behind the cloud's bridge.
`without`: every topic is declared as telemetry, so all go through one queue and one connection. Needs what
`benchmarks.bridges.data_path` needs, and tc with tbf in the kernel.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.bridges.data_path import BRIDGE, DataPath, measure_once
from benchmarks.measuring import bags, pods
from benchmarks.measuring.comparisons import Comparison, record
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.machine import preparing

RECORD = PROJECT / "build" / "bench" / "event-detector.json"
MBIT, SECONDS, LIDARS = 20, 20.0, 2
BURST_BYTES, QUEUE_BYTES = 32 * 1024, 4 * 1024 * 1024
"""Of the token bucket; the queue is more than a second long."""
CONGESTION = "cubic"
AGE_P99_MS_MAX = 250.0
HEALTH_PORT = "ROBOTKUBE_HEALTH_PORT"


@dataclass(frozen=True)
class UplinkAges:
    """Poses and clouds of one run: published, received, and the age of received ones in ms (10,000: or more)."""

    poses_published: int
    poses_received: int
    pose_age_p50_ms: int
    pose_age_p99_ms: int
    clouds_published: int
    clouds_received: int
    cloud_age_p50_ms: int
    bridge_cpu_percent: float


class NarrowUplink(DataPath):
    """One vehicle whose way out is narrow."""

    def __init__(self, folder: Path, kinds: bool, mbit: int, seconds: float, congestion: str) -> None:
        super().__init__(folder, 1, 1, seconds, clouds=True)
        self._kinds, self._mbit, self._congestion = kinds, mbit, congestion
        (agent,) = self.agents
        base = self.tracks[agent][1]
        more = [bags.Track(f"{base.name[:-11]}_{n}/pointcloud", *_rest(base)) for n in range(1, LIDARS)]
        self.tracks[agent] += more
        self.bridged[agent] = list(self.tracks[agent])
        self._vehicle = ""

    def _bridge_settings(self, agent: str) -> dict[str, object]:
        settings: dict[str, Any] = super()._bridge_settings(agent)
        for topic in () if self._kinds else (*settings.get("out", ()), *settings.get("in", ())):
            topic["channel"] = "telemetry"
        return settings

    def _bridge(self, node: int, agent: str, component: str, namespace: str | None = None) -> pods.Pod:
        if agent in self.bridged:
            namespace = self._vehicle = self.nodes.pod(node)
            narrow(namespace, self.nodes.gateway(node), self._mbit, self._congestion)
        return super()._bridge(node, agent, component, namespace)

    def _player(self, node: int, agent: str) -> None:
        """Beside the bridge, so that what goes between them does not pass the uplink."""
        bag = self.folder / "bags" / agent
        self._write_bag(bag, agent)
        settings = {"agent": agent, "bag": str(bag), "ledger": str(self.folder / "ledger" / agent)}
        self._launch("players", node, agent, "bag-player", "robotkube.robots.bags", settings, self._vehicle)

    def _environment(self, agent: str, node: int, name: str) -> dict[str, str]:
        return super()._environment(agent, node, name) | ({} if name == BRIDGE else {HEALTH_PORT: "0"})


def _rest(track: bags.Track) -> tuple[Any, ...]:
    """All of a track but its name."""
    return track.type, track.hertz, track.size, track.offset, track.durability, track.depth


def narrow(namespace: str, broker: str, mbit: int, congestion: str) -> None:
    """Make the way out of a network namespace narrow, and let TCP control congestion towards the broker as named."""
    bucket = ["rate", f"{mbit}mbit", "burst", str(BURST_BYTES), "limit", str(QUEUE_BYTES)]
    for command in (
        ["tc", "qdisc", "add", "dev", "eth0", "root", "tbf", *bucket],
        ["ip", "route", "add", f"{broker}/32", "dev", "eth0", "congctl", congestion],
    ):
        entering = ["nsenter", f"--net=/run/netns/{namespace}", *command]
        done = subprocess.run(entering, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SetUpError(f"{' '.join(command)}: {done.stderr.strip()}; it needs root, tc and the kernel's tbf")


def ages(kinds: bool, mbit: int = MBIT, seconds: float = SECONDS, congestion: str = CONGESTION) -> UplinkAges:
    """Measure one way."""
    measured = measure_once(lambda folder: NarrowUplink(folder, kinds, mbit, seconds, congestion))
    published, received, age = measured["published"], measured["received"], measured["age_ms"]
    if not {"pose", "pointcloud"} <= age.keys():
        raise SetUpError(f"nothing arrived: {measured}")
    return UplinkAges(
        published["pose"], received["pose"], age["pose"]["p50"], age["pose"]["p99"],
        published["pointcloud"], received["pointcloud"], age["pointcloud"]["p50"],
        measured["cpu_percent"]["vehicle bridges"],
    )  # fmt: skip


def compare() -> list[Comparison]:
    """Both ways in one run; SetUpError when a pose was lost."""
    without, kinds = ages(kinds=False), ages(kinds=True)
    values = {
        "narrow_uplink_pose_age_p99_ms": kinds.pose_age_p99_ms,
        "narrow_uplink_baseline_pose_age_p99_ms": without.pose_age_p99_ms,
        "narrow_uplink_poses_lost": kinds.poses_published - kinds.poses_received,
        "narrow_uplink": {"kinds": asdict(kinds), "without": asdict(without)},
    }
    record(RECORD, values)
    if kinds.poses_received != kinds.poses_published:
        raise SetUpError(f"{kinds.poses_published} poses were published, {kinds.poses_received} arrived")
    name = f"pose behind {MBIT} Mbit/s full of clouds, p99"
    ours = float(kinds.pose_age_p99_ms)
    return [
        Comparison(name, "ms", ours, AGE_P99_MS_MAX, 1.0, "the goal"),
        Comparison(name, "ms", ours, float(without.pose_age_p99_ms), 0.5, "without kinds of traffic"),
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mbit", type=int, default=MBIT)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--congestion", default=CONGESTION)
    parser.add_argument("--only", choices=("kinds", "without"))
    options = parser.parse_args(arguments)
    preparing.for_tests()
    ways = [options.only] if options.only else ["without", "kinds"]
    for way in ways:
        measured = ages(way == "kinds", options.mbit, options.seconds, options.congestion)
        print(json.dumps({way: asdict(measured)}), flush=True)


if __name__ == "__main__":
    main()
