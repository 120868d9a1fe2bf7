"""How long a detector that rests takes until it is active, and until its first message after that is there.

    python3 -m benchmarks.detector.activating

The detector is the process of a pod with fifteen vehicles' poses, a proximity rule and an expression; the poses come at
the demo's rate. It is switched by commands to its port and by its ConfigMap in turn, from `inactive` and from
`buffering`. Asked: when the command, or the changed ConfigMap, has arrived in the process.
"""

from __future__ import annotations

import json
import random
import tempfile
import time
import urllib.request
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.detector import detecting
from benchmarks.measuring import pods
from benchmarks.measuring.bags import POSE_TYPE
from benchmarks.measuring.comparisons import Quantiles, quantiles
from ci.errors import SetUpError
from ci.machine import preparing
from robotkube.testing.api_server import ApiServerInMemory

ROUNDS = 25
HELD_SECONDS, RESTING_SECONDS = 0.3, 1.2
"""How long it stays active, and at rest: long enough to look at its subscriptions less often."""
CHANGE_SECONDS_MAX, POLL_SECONDS = 10.0, 0.005
NAMESPACE, NAME = "cloud-0", "event-detector"
COMMAND, CONFIGURATION = "command", "configuration"
WAYS = (
    (COMMAND, "active"),
    (COMMAND, "buffering"),
    (COMMAND, "active"),
    (COMMAND, "inactive"),
    (CONFIGURATION, "active"),
    (CONFIGURATION, "buffering"),
    (CONFIGURATION, "active"),
    (CONFIGURATION, "inactive"),
)


class Activation(NamedTuple):
    """Milliseconds from asked to active, and from asked to the first message that was taken then."""

    active_ms: Quantiles
    first_message_ms: Quantiles


def settings(state: str) -> dict[str, Any]:
    """The detector's settings."""
    base = detecting.settings(detecting.AGENTS)
    pose = "/vehicles/vehicle_00/pose"
    rule = {"name": "high", "kind": "cel", "topic": pose, "fields": {"z": "pose.position.z"}, "expression": "z > 1.0"}
    topics = [*base["topics"], {"name": pose, "type": POSE_TYPE}]
    return {**base, "topics": topics, "rules": [*base["rules"], rule], "state": state}


@dataclass
class Switch:
    """What switches a detector."""

    api: ApiServerInMemory
    port: int

    def configure(self, state: str) -> None:
        """Change the detector's settings by its ConfigMap."""
        self.api.put_config_map(NAMESPACE, NAME, {"config.yaml": json.dumps(settings(state))})

    def go(self, way: str, state: str) -> None:
        """Switch, and stay there for a while."""
        if way == COMMAND:
            self._read("/state", json.dumps({"state": state}).encode())
        else:
            self.configure(state)
        self.wait(lambda status: bool(status["state"] == state))
        time.sleep((RESTING_SECONDS if state == "inactive" else HELD_SECONDS) + random.uniform(0, 0.05))  # noqa: S311

    def wait(self, reached: Any, path: str = "/status") -> None:
        """Wait until the detector says so."""
        deadline = time.monotonic() + CHANGE_SECONDS_MAX
        while not self._holds(reached, path):
            if time.monotonic() > deadline:
                raise SetUpError(f"the detector did not change within {CHANGE_SECONDS_MAX:.0f} s")
            time.sleep(POLL_SECONDS)

    def receive(self) -> None:
        """Wait until messages come."""
        self.wait(lambda counters: sum(one["received"] for one in counters["topics"].values()) > 0, "/input")

    def _holds(self, reached: Any, path: str) -> bool:
        try:
            return bool(reached(json.loads(self._read(path))))
        except OSError:
            return False

    def _read(self, path: str, data: bytes | None = None) -> str:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", data, timeout=5) as answer:
            return str(answer.read().decode())


def activate(rounds: int = ROUNDS) -> Activation:
    """Four activations a round."""
    with tempfile.TemporaryDirectory(prefix="activating-") as name, ApiServerInMemory() as api:
        folder = Path(name)
        switch = Switch(api, pods.free_port())
        switch.configure("inactive")
        activations = _measured(folder, switch, rounds)
    if len(activations) != 4 * rounds:
        raise SetUpError(f"{len(activations)} activations instead of {4 * rounds}")
    return Activation(
        quantiles([(since - asked) / 1e6 for asked, since, _ in activations]),
        quantiles([(first - asked) / 1e6 for asked, _, first in activations]),
    )


def _measured(folder: Path, switch: Switch, rounds: int) -> list[tuple[int, int, int]]:
    (folder / "config.yaml").write_text(json.dumps(settings("inactive")), encoding="utf-8")
    environment = {
        "ROS_DOMAIN_ID": str(random.randrange(1, 100)),  # noqa: S311
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROBOTKUBE_CONFIG": str(folder / "config.yaml"),
        "ROBOTKUBE_CONFIGMAP": f"{NAMESPACE}/{NAME}",
        "ROBOTKUBE_API_SERVER": switch.api.url,
        "ROBOTKUBE_HEALTH_PORT": str(switch.port),
    }
    seconds = rounds * len(WAYS) * RESTING_SECONDS + CHANGE_SECONDS_MAX
    options = ["--agents", str(detecting.AGENTS), "--rate", str(detecting.DEMO_RATE), "--early"]
    options += ["--count", str(int(seconds * detecting.DEMO_RATE))]
    started = [_start("source", folder, environment, *options), _start("activated", folder, environment)]
    try:
        switch.wait(lambda status: status["rules"]["workers"].get("high", {}).get("state") == "running")
        switch.go(COMMAND, "active")  # counts for nothing: the poses may begin later
        switch.receive()
        switch.go(COMMAND, "inactive")
        for way, state in WAYS * rounds:
            switch.go(way, state)
        started[1].stop()
    finally:
        for pod in started:
            pod.stop()
    result: Mapping[str, Any] = json.loads((folder / "activated.json").read_text(encoding="utf-8"))
    return [(asked, since, first) for asked, since, first in result["activations"]][1:]


def _start(role: str, folder: Path, environment: Mapping[str, str], *options: str) -> pods.Pod:
    command = pods.python("benchmarks.detector.peers", role, str(folder / f"{role}.json"), *options)
    return pods.start(role, command, environment, folder / f"{role}.log")


def main() -> None:
    """Measure and print."""
    preparing.for_tests()
    activation = activate()
    print(json.dumps({key: asdict(value) for key, value in activation._asdict().items()}, indent=1))


if __name__ == "__main__":
    main()
