"""Poses from the broker, by an account that may read and nothing else."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.core.poses import PoseSampler
from robotkube.delivery.console.ports import ModelWriting
from robotkube.errors import InputError
from robotkube.foundation.runtime.ports import Series
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel

CONNECTION = "console"
SESSION_SECONDS = 0  # poses of before a loss are of no use after it
TURN_SECONDS = 0.1  # poses of one turn are read together, which costs less than one by one
SOURCE = "broker"
ADVICE = "Positions stand still. Look at the pod of component broker, and at the account observer there."

log = logging.getLogger(__name__)


class BrokerPoses:
    """The connection, on a thread of its own; the events of its channel are its own."""

    def __init__(
        self, account: Callable[[], BrokerAccount], sampler: PoseSampler, model: ModelWriting, now_ms: Callable[[], int]
    ) -> None:
        self._sampler = sampler
        self._model = model
        self._now_ms = now_ms
        self._channel = PahoChannel(account, CONNECTION, SESSION_SECONDS, self)
        self._refusal = ""
        self._received = self._shown = self._unreadable = 0

    def run(self, stopping: threading.Event) -> None:
        """Receive until `stopping` is set."""
        while not stopping.wait(TURN_SECONDS):
            self._channel.turn(time.monotonic())
            self._channel.flush()
            self._model.put_source(SOURCE, self._channel.complaint or self._refusal, ADVICE, (kinds.POSES,))
        self._channel.close()

    def metrics(self) -> list[Series]:
        """What came, and what of it is shown."""
        counts = (
            ("pose_messages", "Messages of poses that came.", self._received),
            ("poses", "Poses that were shown.", self._shown),
            ("pose_messages_unreadable", "Messages of poses that could not be read.", self._unreadable),
        )
        return [Series(f"robotkube_console_{n}_total", "counter", text, {(): float(v)}) for n, text, v in counts]

    # port ChannelEvents ----------------------------------------------------------------------------------------------

    def connected(self, session_kept: bool) -> None:
        """Hear everybody's poses."""
        self._refusal = ""
        self._channel.subscribe([self._sampler.topic])

    def disconnected(self) -> None:
        """The channel's complaint says so."""

    def acknowledged(self, token: int, heard: bool) -> None:
        """Nothing is sent."""

    def rejected(self, token: int, reason: str) -> None:
        """Nothing is sent."""

    def refused(self, topic: str, reason: str) -> None:
        """The account may not hear poses."""
        self._refusal = f"{topic}: {reason}"

    def granted(self, topic: str) -> None:
        """It may after all."""
        self._refusal = ""

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        """Show the pose, when one of this agent is due."""
        self._received += 1
        try:
            sampled = self._sampler.sample(topic, payload, self._now_ms())
        except (ValueError, InputError) as error:
            self._unread(topic, error)
            return
        if sampled is not None:
            self._shown += 1
            self._model.put(kinds.POSES, *sampled)

    def _unread(self, topic: str, error: Exception) -> None:
        if not self._unreadable:
            log.warning("pose cannot be read topic=%s reason=%s", topic, error)
        self._unreadable += 1
