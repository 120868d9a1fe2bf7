"""How old a message is when a link has carried it: from vehicle to vehicle, and by way of a road-side unit.

    python3 -m benchmarks.broker.links [--seconds 30]

Three agents, each with a node, a real bridge and an account of its own, at a broker that speaks TLS. One vehicle says
its pose at 100 Hz. The other vehicle hears it, and what a road-side unit publishes of each pose under its own name. The
age is that at a ROS subscription behind the other vehicle's bridge. The baseline is the same message, as often, from
one plain client to another at the same broker, at the same time. Writes `link_end_to_end_ms` to build/bench/links.json.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from benchmarks.bridges.data_path import DataPath
from benchmarks.bridges.peers import POSE_BYTES
from benchmarks.broker.link_peers import HERTZ, WARMING_UP
from benchmarks.measuring import bags, pods
from benchmarks.measuring.comparisons import Comparison, Quantiles, quantiles, record
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.machine import preparing
from robotkube.foundation.certificates.adapters.verification import ServerVerification, client_context

RECORD = PROJECT / "build" / "bench" / "links.json"
SPEAKER, UNIT, HEARER = "vehicle-00", "roadside-0", "vehicle-01"
SAID, SEEN = "/vehicles/vehicle_00/pose", "/vehicles/roadside_0/pose"
HEARD = {SPEAKER: (), UNIT: (SAID,), HEARER: (SAID, SEEN)}
SPOKEN = {SPEAKER: (SAID,), UNIT: (SEEN,), HEARER: ()}
PLAIN, PLAIN_TOPIC = "plain", "plain/pose"
SECONDS = 30.0
PERIOD_MS = 40
"""Of the bridges: what they received is sent, and what came is published, this often."""
ALLOWANCE_MS = 20.0
"""Of one link beyond its bridges' periods."""
HOPS = 3
"""Of a link, each of which may take what plain delivery takes: ROS, broker, ROS."""
WAIT_SECONDS_MAX = 60.0


@dataclass(frozen=True)
class LinkAges:
    """Ages in ms of one run, by way; `plain` is the baseline."""

    vehicle_vehicle: Quantiles
    vehicle_roadside_vehicle: Quantiles
    plain: Quantiles


class LinkPath(DataPath):
    """Two vehicles and a road-side unit that hear each other."""

    encrypted = True

    def __init__(self, folder: Path, seconds: float) -> None:
        super().__init__(folder, 1, 0, seconds)

    def _accounts(self) -> dict[str, list[str]]:
        accounts = {
            agent: [
                *pods.vehicle_rules(agent),
                *(f"topic read {prefix}mqtt{topic}" for topic in topics for prefix in pods.PREFIXES),
            ]
            for agent, topics in HEARD.items()
        }
        return {**accounts, PLAIN: [f"topic readwrite {PLAIN_TOPIC}"]}

    def _bridge_settings(self, agent: str) -> dict[str, object]:
        return {"agent": agent, "out": _items(SPOKEN[agent]), "in": _items(HEARD[agent])}

    def begin(self) -> None:
        """Start the broker, every bridge, the road-side unit's service and the receiver."""
        self.broker.start()
        self.node_of = {agent: self.nodes.node() for agent in HEARD}
        for agent, node in self.node_of.items():
            self._bridge(node, agent, "bridges")
        self._run(UNIT, "relay", SAID, SEEN)
        self._run(HEARER, "hear", str(self.result), *HEARD[HEARER], "--count", str(self.count))

    def speak(self) -> None:
        """Begin to say poses."""
        self._run(SPEAKER, "say", SAID, "--count", str(self.count))

    @property
    def count(self) -> int:
        """How many poses count."""
        return int(self.seconds * HERTZ)

    @property
    def result(self) -> Path:
        """The file with the ages, once all of them have come."""
        return self.folder / "heard.json"

    def _run(self, agent: str, role: str, *arguments: str) -> None:
        """Run a program beside an agent's bridge, on its node."""
        command = pods.python("benchmarks.broker.link_peers", role, *arguments)
        log = self.folder / agent / f"{role}.log"
        self.pods.append(pods.start(role, command, {}, log, self.nodes.pod(self.node_of[agent])))


class PlainDelivery:
    """The same message from one client to another at the same broker; `milliseconds` each took."""

    def __init__(self, broker: pods.Broker) -> None:
        self.milliseconds: list[float] = []
        self._tls = ServerVerification(broker.folder / "ca.crt", "broker")
        self._port = broker.port
        self._sender, self._receiver = self._client(), self._client()
        self._receiver.on_message = self._came
        self._subscribed = threading.Event()
        self._receiver.on_subscribe = lambda *_: self._subscribed.set()
        self._receiver.subscribe(PLAIN_TOPIC, qos=1)
        if not self._subscribed.wait(WAIT_SECONDS_MAX):
            raise SetUpError("the broker does not answer a plain client")

    def _client(self) -> mqtt.Client:
        client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        client.username_pw_set(PLAIN, pods.password(PLAIN))
        client.tls_set_context(client_context(self._tls))
        client.connect("127.0.0.1", self._port)
        client.loop_start()
        return client

    def _came(self, _client: Any, _data: Any, message: Any) -> None:
        sent = int.from_bytes(message.payload[:8], "little")
        self.milliseconds.append((time.monotonic_ns() - sent) / 1e6)

    def send(self, seconds: float) -> None:
        """Send for so long, as often as the vehicle does."""
        began = time.monotonic()
        for number in range(int(seconds * HERTZ)):
            time.sleep(max(0.0, began + number / HERTZ - time.monotonic()))
            payload = time.monotonic_ns().to_bytes(8, "little").ljust(POSE_BYTES, b"\x5a")
            self._sender.publish(PLAIN_TOPIC, payload, qos=1)

    def close(self) -> None:
        """End both connections."""
        for client in (self._sender, self._receiver):
            client.disconnect()
            client.loop_stop()


def _items(topics: Sequence[str]) -> list[dict[str, object]]:
    kept = {"type": bags.POSE_TYPE, "channel": "telemetry", "durability": "volatile", "depth": 1000}
    return [{"name": topic, **kept} for topic in topics]


def ages(seconds: float = SECONDS) -> LinkAges:
    """Measure once, in a temporary folder. SetUpError when a pose is lost, since then ages say nothing."""
    with tempfile.TemporaryDirectory(prefix="links-") as name:
        Path(name).chmod(0o755)
        path = LinkPath(Path(name), seconds)
        try:
            with path.api:
                return _measured(path)
        finally:
            path.close()


def _measured(path: LinkPath) -> LinkAges:
    path.begin()
    _until(lambda: all(path.connected(agent) for agent in HEARD), "the bridges connect")
    plain = PlainDelivery(path.broker)
    path.speak()
    time.sleep(WARMING_UP / HERTZ)
    plain.send(path.seconds)
    _until(path.result.exists, f"all {path.count} poses arrive both ways")
    plain.close()
    heard = json.loads(path.result.read_text())
    return LinkAges(quantiles(heard[SAID]), quantiles(heard[SEEN]), quantiles(plain.milliseconds))


def _until(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + WAIT_SECONDS_MAX
    while not condition():
        if time.monotonic() > end:
            raise SetUpError(f"not within {WAIT_SECONDS_MAX:.0f} s: {what}")
        time.sleep(0.1)


def compare() -> list[Comparison]:
    """Both ways against plain delivery."""
    measured = ages()
    record(RECORD, {"link_end_to_end_ms": asdict(measured)})
    floor = measured.plain.p99
    return [
        Comparison(f"{name}, p99", "ms", ours.p99, floor, links * _link_ms_max(floor) / floor, "plain delivery")
        for name, ours, links in (
            ("vehicle to vehicle", measured.vehicle_vehicle, 1),
            ("vehicle to road-side to vehicle", measured.vehicle_roadside_vehicle, 2),
        )
    ]


def _link_ms_max(plain_ms: float) -> float:
    """What one link may take where plain delivery takes so long."""
    return 2 * PERIOD_MS + ALLOWANCE_MS + HOPS * plain_ms


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    options = parser.parse_args(arguments)
    preparing.for_tests()
    print(json.dumps(asdict(ages(options.seconds))), flush=True)


if __name__ == "__main__":
    main()
