"""What the path of a pose costs: players, bridges, broker and the detector's input at the scenario's full rate.

    python3 -m benchmarks.bridges.data_path --vehicles 15 --lidars 2 --seconds 20 [--clouds]

Every process is a pod's process (entrypoints, settings, Secret, ConfigMap over HTTP) in a network namespace of its own.
Prints CPU per component in % of one core, memory, CPU seconds of the start, and the age of poses at the detector's
input. Needs root, ip, nsenter and mosquitto.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.measuring import bags, pods
from ci.errors import SetUpError
from robotkube.testing.api_server import ApiServerInMemory

CONNECT_SECONDS_MAX = 60.0
LEAD_SECONDS = 3.0
SETTLE_SECONDS = 2.0
BRIDGE = "mqtt-bridge"


class DataPath:
    """All processes of one measurement; `encrypted`: bridges and broker speak TLS."""

    encrypted = False

    def __init__(
        self, folder: Path, vehicles: int, lidars: int, seconds: float, clouds: bool = False, period_ms: int = 40
    ) -> None:
        self.folder, self.seconds, self.period_ms = folder, seconds, period_ms
        self.agents = [f"vehicle-{number:02d}" for number in range(vehicles)]
        self.tracks = {
            agent: [bags.pose_track(agent), *(bags.lidar_tracks(agent) if number < lidars else [])]
            for number, agent in enumerate(self.agents)
        }
        self.bridged = {agent: list(tracks if clouds else tracks[:1]) for agent, tracks in self.tracks.items()}
        self.hashes = False
        self.nodes = pods.Nodes()
        self.api = ApiServerInMemory("0.0.0.0")  # noqa: S104 - pods reach it at their node's gateway
        self.broker = pods.Broker(folder / "broker", self._accounts(), encrypted=self.encrypted)
        self.pods: list[pods.Pod] = []
        self.players: dict[str, str] = {}  # agent -> address

    def _accounts(self) -> dict[str, list[str]]:
        """The broker's accounts, with the lines of their ACL."""
        return {**{agent: pods.vehicle_rules(agent) for agent in self.agents}, "cloud-0": pods.CLOUD_RULES}

    def close(self) -> None:
        """End everything."""
        for pod in self.pods:
            pod.process.terminate()
        for pod in self.pods:
            pod.stop()
        self.broker.stop()
        self.nodes.close()

    def begin(self) -> None:
        """Start broker, receiver, cloud bridge, then bridges and players of the vehicles."""
        self.broker.start()
        cloud = self.nodes.node()
        self._receiver(cloud)
        self.cloud_bridge = self._bridge(cloud, "cloud-0", "cloud bridge")
        for agent in self.agents:
            node = self.nodes.node()
            self._bridge(node, agent, "vehicle bridges")
            self._player(node, agent)

    def configure(self) -> None:
        """Give all bridges the settings that fit `bridged`."""
        for agent in [*self.agents, "cloud-0"]:
            self.api.put_config_map(agent, BRIDGE, {"config.yaml": json.dumps(self._bridge_settings(agent))})

    def restart_cloud_bridge(self) -> None:
        """End it as a pod is ended, and start it in the same place."""
        self.cloud_bridge.stop()
        self.pods.remove(self.cloud_bridge)
        self.cloud_bridge = self._bridge(0, "cloud-0", "cloud bridge", self.cloud_namespace)

    def connected(self, agent: str) -> bool:
        """Return whether the agent's bridge has been connected."""
        return '"connected"' in (self.folder / agent / f"{BRIDGE}.log").read_text()

    def unheard(self) -> dict[str, str]:
        """Agent -> what its player lacks: topics that are bridged and that nobody has subscribed to, whose messages
        would be lost; or that it does not answer."""
        lacks = {agent: self._unheard(agent) for agent in self.agents}
        return {agent: text for agent, text in lacks.items() if text}

    def _unheard(self, agent: str) -> str:
        lines = set(_metrics(self.players[agent]).splitlines())
        count = 'robotkube_player_matched_subscriptions{{topic="{}"}} 0'
        names = [track.name for track in self.bridged[agent] if count.format(track.name) in lines]
        return ", ".join(names) if lines else "no answer"

    def order(self, start: int) -> None:
        """Let all players play from `start` (ns)."""
        for agent in self.agents:
            self.api.put_config_map(agent, "simulation", {"run": "benchmark", "start": str(start)})

    def costs(self) -> Counter[str]:
        """CPU seconds per component so far."""
        costs: Counter[str] = Counter()
        for pod in [*self.pods, *([self.broker.pod] if self.broker.pod else [])]:
            costs[pod.component] += pod.cpu_seconds()  # type: ignore[assignment]
        return costs

    def memory(self) -> dict[str, int]:
        """The largest process per component, in bytes."""
        largest: dict[str, int] = {}
        for pod in self.pods:
            largest[pod.component] = max(largest.get(pod.component, 0), pod.memory_bytes())
        return largest

    def _bridge_settings(self, agent: str) -> dict[str, object]:
        everything = [track for tracks in self.bridged.values() for track in tracks]
        if agent in self.bridged:
            return {"agent": agent, "out": _items(self.bridged[agent])}
        return {"agent": agent, "in": _items(everything)}

    def _environment(self, agent: str, node: int, name: str) -> dict[str, str]:
        port = self.api.url.rpartition(":")[2]
        return {
            "ROBOTKUBE_API_SERVER": f"http://{self.nodes.gateway(node)}:{port}",
            "ROBOTKUBE_CONFIGMAP": f"{agent}/{name}",
            "ROBOTKUBE_CONFIG": str(self.folder / agent / f"{name}.yaml"),
            "ROBOTKUBE_SECRETS": str(self.broker.secret(agent, self.nodes.gateway(node))),
            "ROBOTKUBE_PERIOD_MS": str(self.period_ms),
        }

    def _launch(
        self,
        component: str,
        node: int,
        agent: str,
        name: str,
        module: str,
        settings: object,
        namespace: str | None = None,
    ) -> pods.Pod:
        text = json.dumps(settings)
        path = self.folder / agent / f"{name}.yaml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        self.api.put_config_map(agent, name, {"config.yaml": text})
        environment = self._environment(agent, node, name)
        log = self.folder / agent / f"{name}.log"
        place = namespace or self.nodes.pod(node)
        self.pods.append(pods.start(component, pods.python(module), environment, log, place))
        return self.pods[-1]

    def _bridge(self, node: int, agent: str, component: str, namespace: str | None = None) -> pods.Pod:
        place = namespace or self.nodes.pod(node)
        if agent not in self.bridged:
            self.cloud_namespace = place
        settings = self._bridge_settings(agent)
        return self._launch(component, node, agent, BRIDGE, "robotkube.robots.bridge", settings, place)

    def _player(self, node: int, agent: str) -> None:
        bag = self.folder / "bags" / agent
        self._write_bag(bag, agent)
        settings = {"agent": agent, "bag": str(bag), "ledger": str(self.folder / "ledger" / agent)}
        place = self.nodes.pod(node)
        self.players[agent] = self.nodes.address(node, place)
        self._launch("players", node, agent, "bag-player", "robotkube.robots.bags", settings, place)

    def _write_bag(self, folder: Path, agent: str) -> None:
        bags.write_bag(folder, self.tracks[agent], self.seconds)

    def _receiver(self, node: int) -> None:
        """Subscribes to every topic of the bags, also to those that are not bridged (yet)."""
        tracks = [track for tracks in self.tracks.values() for track in tracks]
        topics = [f"{t.name}={t.type}{':latched' if t.durability == 'transient_local' else ''}" for t in tracks]
        options = ["--hashes"] if self.hashes else []
        command = pods.python("benchmarks.bridges.receiver", str(self.folder / "received.json"), *options, *topics)
        log = self.folder / "receiver.log"
        self.pods.append(pods.start("detector input", command, {}, log, self.nodes.pod(node)))


def _metrics(address: str) -> str:
    """A pod's metrics; empty when it does not answer."""
    connection = http.client.HTTPConnection(address, 8081, timeout=5)
    try:
        connection.request("GET", "/metrics")
        return connection.getresponse().read().decode()
    except (OSError, http.client.HTTPException):
        return ""
    finally:
        connection.close()


def _items(tracks: list[bags.Track]) -> list[dict[str, object]]:
    return [
        {
            "name": track.name,
            "type": track.type,
            "channel": "bulk" if track.size > 100_000 else "telemetry",
            "durability": track.durability,
            "depth": track.depth,
        }
        for track in tracks
    ]


def quantile(ages: Counter[int], part: float) -> int:
    """The age in ms below which `part` of all messages lie."""
    wanted = part * sum(ages.values())
    so_far = 0
    for age, count in sorted(ages.items()):
        so_far += count
        if so_far >= wanted:
            return age
    return -1


def measure(testbed: DataPath) -> dict[str, object]:
    """Run once; the numbers as printed."""
    testbed.begin()
    begin = time.monotonic()
    while not all(testbed.connected(agent) for agent in [*testbed.agents, "cloud-0"]):
        if time.monotonic() - begin > CONNECT_SECONDS_MAX:
            raise SystemExit(f"the bridges do not connect; see {testbed.folder}")
        time.sleep(0.1)
    time.sleep(SETTLE_SECONDS)
    started = testbed.costs()
    start = int((time.time() + LEAD_SECONDS) * 1e9)
    testbed.order(start)
    time.sleep(LEAD_SECONDS + 2)
    before = testbed.costs()
    idle_before = _idle_seconds()
    moment = time.monotonic()
    time.sleep(testbed.seconds - 4)
    elapsed = time.monotonic() - moment
    after = testbed.costs()
    idle_after = _idle_seconds()
    memory = testbed.memory()
    time.sleep(4)
    testbed.close()
    return {
        "cpu_percent": {key: round(100 * (after[key] - before[key]) / elapsed, 2) for key in after},
        "start_cpu_seconds": {key: round(value, 2) for key, value in started.items()},
        "memory_mib": {key: round(value / 2**20, 1) for key, value in memory.items()},
        "machine_busy_percent": round(100 * (os.cpu_count() or 1) - 100 * (idle_after - idle_before) / elapsed, 1),
        **_received(testbed),
    }


def measure_once(make: Callable[[Path], DataPath]) -> dict[str, Any]:
    """The numbers of one run in a temporary folder, for which `make` gives the processes."""
    with tempfile.TemporaryDirectory(prefix="data-path-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        testbed = make(folder)
        try:
            with testbed.api:
                return dict(measure(testbed))
        finally:
            testbed.close()


def measure_lossless(make: Callable[[Path], DataPath], what: str) -> dict[str, Any]:
    """Measure as `measure_once` does; SetUpError when messages were lost, since then the numbers say nothing. `what`
    names the run."""
    measured = measure_once(make)
    if measured["received"] != measured["published"]:
        raise SetUpError(f"{what}: {measured['published']} were published, {measured['received']} arrived")
    return measured


def _received(testbed: DataPath) -> dict[str, object]:
    result = json.loads((testbed.folder / "received.json").read_text())
    ages: dict[str, Counter[int]] = {"pose": Counter(), "pointcloud": Counter()}
    counts: Counter[str] = Counter()
    for name, topic in result.items():
        kind = name.rpartition("/")[2]
        counts[kind] += topic["received"]
        for age, count in topic["ages_ms"]:
            ages.setdefault(kind, Counter())[age] += count
    published: Counter[str] = Counter()
    for path in (testbed.folder / "ledger").glob("*/benchmark/*.jsonl"):
        published[path.stem.rpartition("__")[2]] += sum("sequence" in line for line in path.open())
    return {
        "received": dict(counts),
        "published": dict(published),
        "age_ms": {
            kind: {"p50": quantile(a, 0.5), "p99": quantile(a, 0.99), "max": max(a)} for kind, a in ages.items() if a
        },
    }


def _idle_seconds() -> float:
    fields = Path("/proc/stat").read_text().splitlines()[0].split()
    return (int(fields[4]) + int(fields[5])) / pods.CLOCK_TICKS


def main() -> None:
    """Measure and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=15)
    parser.add_argument("--lidars", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--clouds", action="store_true", help="bridge clouds and transforms, too")
    parser.add_argument("--mtu", type=int, default=1500, help="of the pods' network")
    parser.add_argument("--period-ms", type=int, default=40, help="of the bridges")
    parser.add_argument("--keep", action="store_true", help="leave logs and ledgers")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="data-path-"))
    folder.chmod(0o755)
    testbed = DataPath(folder, options.vehicles, options.lidars, options.seconds, options.clouds, options.period_ms)
    testbed.nodes.mtu = options.mtu
    try:
        with testbed.api:
            print(json.dumps(measure(testbed), indent=1))
    finally:
        testbed.close()
        if options.keep:
            print(f"logs: {folder}")
        else:
            import shutil

            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
