"""The telemetry of an agent's bridge at a real broker, without the bridge: one connection that hears one topic."""

from __future__ import annotations

import time
from collections.abc import Callable

from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel
from tests.stages.delivery.rights.kept_rights import KeptRights
from tests.stages.waiting import until


def connection_of(agent: str) -> str:
    """The name of the connection."""
    return f"{agent}-telemetry"


class AgentTelemetry:
    """What it `heard`, whether its sessions were kept, and how often it lost its connection."""

    def __init__(self, stage: KeptRights, agent: str, topic: str) -> None:
        account = stage.broker.account(agent)
        self.topic = topic
        self.heard: list[bytes] = []
        self.sessions: list[bool] = []
        self.losses = 0
        self.channel = PahoChannel(lambda: account, connection_of(agent), 60, self)
        self.until(lambda: self.sessions, "a connection")

    def until(self, condition: Callable[[], object], about: str) -> None:
        until(lambda: (self.turn(), condition())[1], about)

    def turn(self) -> None:
        self.channel.turn(time.monotonic())
        self.channel.flush()

    def connected(self, session_kept: bool) -> None:
        self.sessions.append(session_kept)
        self.channel.subscribe([self.topic])

    def disconnected(self) -> None:
        self.losses += 1

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        self.heard.append(payload)

    def acknowledged(self, token: int, heard: bool) -> None: ...

    def rejected(self, token: int, reason: str) -> None: ...

    def refused(self, topic: str, reason: str) -> None: ...

    def granted(self, topic: str) -> None: ...
