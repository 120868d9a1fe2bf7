"""What a detector tells others: nothing before its settings were read anew after a cut, and then all of it."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from robotkube.errors import UnavailableError
from robotkube.foundation.runtime.loops.fencing import FRESH_SECONDS, Fencing
from robotkube.robots.detector.loops.broker import Broker, MqttReactions
from robotkube.robots.mqtt.ports import ChannelEvents
from robotkube.robots.reactions.core.settings import MqttReactionSettings
from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
from robotkube.robots.reactions.loops.fenced_sender import FencedSender
from robotkube.robots.reactions.ports.deliveries import EdgeDelivery
from robotkube.robots.rules.core import START
from tests.stages.runtime.settings_reading import Reading

MOVABLE = {"movable": "true"}


def delivery(number: int) -> EdgeDelivery:
    return EdgeDelivery(f"{number}-{START}", START, "", b"%d" % number)


class Channel:
    """A connection that takes everything."""

    complaint: str | None = None

    def __init__(self) -> None:
        self.published: list[bytes] = []

    def turn(self, now: float) -> None: ...

    def publish(self, topic: str, payload: bytes, retained: bool, properties: bytes = b"") -> int | None:
        self.published.append(payload)
        return len(self.published)

    def subscribe(self, topics: Sequence[str]) -> None: ...

    def unsubscribe(self, topics: Sequence[str]) -> None: ...

    def flush(self) -> None: ...

    def close(self) -> None: ...


class Receiver:
    """Port Sender, in memory."""

    def __init__(self) -> None:
        self.sent: list[EdgeDelivery] = []
        self.probed = self.closed = False

    def probe(self) -> None:
        self.probed = True

    def send(self, delivery: EdgeDelivery) -> None:
        self.sent.append(delivery)

    def close(self) -> None:
        self.closed = True


class Stage:
    def __init__(self) -> None:
        self.now = 100.0
        self.reading = Reading(read_at=100.0)
        self.channel = Channel()
        self.fencing = Fencing("edge-0", True, lambda: self.now)
        self.fencing.watch(self.reading)
        clock = lambda: self.now  # noqa: E731
        self.broker = Broker(self._make, lambda: 1, clock, lambda name: None, lambda gap: None, self.fencing)
        self.box = DeadLetterBox(lambda: 1)
        settings = MqttReactionSettings("near", "alerts", retry_seconds=3600.0)
        self.reaction = MqttReactions(settings, self.broker, self.box, lambda: self.now)
        self.broker.connected(False)

    def _make(self, events: ChannelEvents) -> Channel:
        return self.channel

    def cut(self) -> None:
        """The broker was out of reach for so long that the settings have to be read again."""
        self.broker.disconnected()
        self.now += 2 * FRESH_SECONDS
        self.broker.connected(True)


def test_messages_wait_for_the_settings_and_go_out_in_their_order() -> None:
    stage = Stage()
    stage.reaction.react(delivery(1))
    stage.broker.turn()
    stage.broker.acknowledged(1, True)
    assert stage.reading.asked == 0
    stage.cut()
    for number in (2, 3):
        stage.reaction.react(delivery(number))
        stage.broker.turn()
    assert stage.channel.published == [b"1"]
    assert stage.reading.asked == 1
    stage.fencing.observe(MOVABLE)
    stage.reading.read_at = stage.now
    stage.broker.turn()
    assert stage.channel.published == [b"1", b"2", b"3"]


def test_messages_of_a_release_that_was_taken_over_become_dead_letters() -> None:
    stage = Stage()
    stage.cut()
    stage.reaction.react(delivery(1))
    stage.broker.turn()
    stage.fencing.observe(None)
    assert not stage.broker.close(1.0, lambda seconds: pytest.fail("nobody waits for what is in vain"))
    assert stage.channel.published == []
    assert stage.reaction.counts()["dead"] == 1


def test_deliveries_are_tried_again_while_nobody_knows() -> None:
    receiver = Receiver()
    reading = Reading()
    fencing = Fencing("edge-0", True, lambda: 100.0)
    fencing.watch(reading)
    sender = FencedSender(receiver, fencing)
    sender.probe()
    with pytest.raises(UnavailableError, match="read anew first"):
        sender.send(delivery(1))
    reading.read_at = 100.0
    sender.send(delivery(1))
    sender.close()
    assert (receiver.sent, receiver.probed, receiver.closed) == ([delivery(1)], True, True)
