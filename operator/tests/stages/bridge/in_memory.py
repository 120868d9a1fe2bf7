"""A bridge with a network and connections in memory."""

from __future__ import annotations

from typing import Any

from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.robots.bridge.core.settings import BridgeSettings, read_bridge_settings
from robotkube.robots.bridge.loops.bridge import Bridge
from robotkube.robots.bridge.loops.flows import SendingSession
from robotkube.robots.bridge.loops.link_reporting import LinkReporting
from tests.stages.bridge.memory_network import Channel, Network

TRACE = "ab" * 16
POSE = {"name": "/vehicles/vehicle_00/pose", "type": "geometry_msgs/msg/PoseStamped"}
EVERYBODY = {**POSE, "name": "/vehicles/{agent}/pose"}
CLOUD = {"name": "/vehicles/vehicle_00/cloud", "type": "sensor_msgs/msg/PointCloud2", "channel": "bulk"}
TRANSFORM = {
    "name": "/vehicles/vehicle_00/transform",
    "type": "geometry_msgs/msg/TransformStamped",
    "durability": "transient_local",
}


class BridgeStage:
    def __init__(self, reporting: LinkReporting | None = None) -> None:
        self.network = Network()
        self.channels: dict[str, Channel] = {}
        self.lines: list[str] = []
        self.events: list[tuple[str, dict[str, Any]]] = []
        self.now_ns = 1_000
        sender = SendingSession(42, lambda: self.now_ns, lambda name: f"definition of {name}", TRACE)
        self.bridge = Bridge(self.network, self.channel, sender, self.log, Fencing(), reporting)

    def channel(self, agent: str, name: str, events: Any) -> Channel:
        self.channels[name] = Channel(f"{agent}-{name}", events)
        return self.channels[name]

    def log(self, event: str, **fields: Any) -> None:
        self.lines.append(f"{event} {fields}")
        self.events.append((event, fields))

    def configure(self, out: list[Any] | None = None, into: list[Any] | None = None, **others: Any) -> None:
        self.bridge.configure(settings(out, into, **others))

    def logged(self, event: str) -> list[dict[str, Any]]:
        """Fields of every line of that kind."""
        return [fields for logged, fields in self.events if logged == event]

    def connect(self) -> None:
        for channel in self.channels.values():
            if channel.complaint is not None:
                channel.connect()


def settings(out: list[Any] | None = None, into: list[Any] | None = None, **others: Any) -> BridgeSettings:
    document = {"agent": "vehicle-00", "out": out or [], "in": into or [], **others}
    return read_bridge_settings(document, "config.yaml")
