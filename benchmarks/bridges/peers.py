"""The other ends of a bridge in measurements: a source and a sink of PoseStamped, on ROS or at the broker.

    python3 -m benchmarks.bridges.peers {ros,mqtt}-{source,sink} RESULT --topic /p --count 100000 --rate 12000

A source waits until its end is there (a subscription, a listener), then sends `count` messages, `rate` a second. A
sink ends when it has `count` messages, or when it is told to. RESULT is JSON: `messages`, and `first` and `last`, when
they were sent or came (ns of a clock that all processes share); of a sink also `twice`, messages that came again.
The broker's account is that of the mounted Secret, as in a pod.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.measuring.bags import POSE_TYPE, message
from robotkube.foundation.runtime.process import PodSettings, Process, run
from robotkube.robots.mqtt.adapters.broker_account import read_broker_account
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel
from robotkube.robots.mqtt.core.batches import decode_batch, encode_batch
from robotkube.robots.mqtt.core.message_properties import MQTT_PREFIX
from robotkube.robots.ros.adapters.rclpy_node import RosNode

POSE_BYTES = 76
READY_SECONDS_MAX = 30.0
PERIOD_SECONDS = 0.005
BATCH_SECONDS = 0.04
DEPTH = 20_000
INFLIGHT_MAX = 50
NUMBER_PLACE = slice(20, 28)  # where `bags.message` writes the message's number


class Sink:
    """Counts what comes, each number once."""

    def __init__(self, wanted: int) -> None:
        self.seen = bytearray(wanted)
        self.messages = self.twice = self.first = self.last = 0

    def receive(self, data: bytes) -> None:
        """One message."""
        number = int.from_bytes(data[NUMBER_PLACE], "little")
        if self.seen[number]:
            self.twice += 1
            return
        self.seen[number] = 1
        self.messages += 1

    def noted(self) -> None:
        """Count a batch that has come."""
        self.last = time.monotonic_ns()
        self.first = self.first or self.last

    def result(self) -> Mapping[str, int]:
        """What RESULT holds."""
        return {"messages": self.messages, "twice": self.twice, "first": self.first, "last": self.last}


class Listener:
    """The events of a connection; batches go to `sink`."""

    def __init__(self, sink: Sink | None = None) -> None:
        self.sink = sink
        self.unacknowledged = 0
        self.heard = False

    def connected(self, session_kept: bool) -> None:
        """See the port."""

    def disconnected(self) -> None:
        """See the port."""

    def refused(self, topic: str, reason: str) -> None:
        """See the port."""
        raise SystemExit(f"{topic}: {reason}")

    def granted(self, topic: str) -> None:
        """See the port."""

    def acknowledged(self, token: int, heard: bool) -> None:
        """See the port."""
        self.unacknowledged -= 1
        self.heard = self.heard or heard

    def rejected(self, token: int, reason: str) -> None:
        """See the port."""
        raise SystemExit(reason)

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        """See the port."""
        assert self.sink is not None
        for data in decode_batch(payload).messages:
            self.sink.receive(data)


def paced(process: Process, options: argparse.Namespace, period: float, send: Callable[[int, int], None]) -> Any:
    """`send(begin, end)` numbers of messages at the rate asked for; the result."""
    first = time.monotonic_ns()
    done = 0
    while done < options.count and not process.stopping.is_set():
        due = min(options.count, int((time.monotonic_ns() - first) * options.rate / 1e9) + 1)
        if due > done:
            send(done, due)
            done = due
        time.sleep(period)
    return {"messages": done, "first": first, "last": time.monotonic_ns()}


def ros_source(process: Process, options: argparse.Namespace) -> Any:
    """Publishes on ROS."""
    output = RosNode("source").advertise(options.topic, POSE_TYPE, depth=DEPTH)
    until(lambda: output.matched)

    def send(begin: int, end: int) -> None:
        for number in range(begin, end):
            output.publish(message(number, time.time_ns(), POSE_BYTES))

    result = paced(process, options, PERIOD_SECONDS, send)
    process.stopping.wait(READY_SECONDS_MAX)  # what was lost on the way may be asked for again
    return result


def ros_sink(process: Process, options: argparse.Namespace) -> Any:
    """Receives from ROS."""
    sink = Sink(options.count)
    source = RosNode("sink").subscribe(options.topic, POSE_TYPE, depth=DEPTH)
    while sink.messages < options.count and not process.stopping.wait(PERIOD_SECONDS * 4):
        if messages := source.take(DEPTH):
            for data in messages:
                sink.receive(data)
            sink.noted()
    return sink.result()


def mqtt_channel(name: str, events: Listener) -> PahoChannel:
    """A connection that is made."""
    pod = PodSettings.from_environment()
    channel = PahoChannel(lambda: read_broker_account(pod.broker_folder), name, 60, events)

    def connected() -> bool:
        channel.turn(time.monotonic())
        channel.flush()
        return channel.complaint is None

    until(connected)
    return channel


def mqtt_source(process: Process, options: argparse.Namespace) -> Any:
    """Publishes batches as a bridge does: one for every BATCH_SECONDS, at most INFLIGHT_MAX on their way."""
    events = Listener()
    channel = mqtt_channel("source", events)
    session = time.time_ns()
    batches = 0
    topic = MQTT_PREFIX + options.topic

    def publish(messages: list[bytes]) -> None:
        nonlocal batches
        assert channel.publish(topic, encode_batch(session, batches, messages), False) is not None
        events.unacknowledged += 1
        batches += 1
        turn()

    def turn() -> bool:
        channel.flush()
        channel.turn(time.monotonic())
        return events.unacknowledged < INFLIGHT_MAX

    def send(begin: int, end: int) -> None:
        until(turn)
        publish([message(number, time.time_ns(), POSE_BYTES) for number in range(begin, end)])

    def listened() -> bool:
        if not events.unacknowledged:
            publish([])
        return turn() and events.heard

    until(listened)
    result = paced(process, options, BATCH_SECONDS, send)
    until(lambda: turn() and not events.unacknowledged)
    return result


def mqtt_sink(process: Process, options: argparse.Namespace) -> Any:
    """Receives batches."""
    sink = Sink(options.count)
    channel = mqtt_channel("sink", Listener(sink))
    channel.subscribe([MQTT_PREFIX + options.topic])
    while sink.messages < options.count and not process.stopping.wait(PERIOD_SECONDS * 4):
        before = sink.messages
        channel.turn(time.monotonic())
        channel.flush()
        if sink.messages > before:
            sink.noted()
    return sink.result()


def until(condition: Callable[[], object]) -> None:
    """Returns when the condition holds; SystemExit when it does not in time."""
    deadline = time.monotonic() + READY_SECONDS_MAX
    while not condition():
        if time.monotonic() > deadline:
            raise SystemExit(f"the other end is not there within {READY_SECONDS_MAX} s")
        time.sleep(0.002)


ROLES = {"ros-source": ros_source, "ros-sink": ros_sink, "mqtt-source": mqtt_source, "mqtt-sink": mqtt_sink}


def body(process: Process) -> None:
    """Play the role and write the result."""
    parser = argparse.ArgumentParser()
    parser.add_argument("role", choices=sorted(ROLES))
    parser.add_argument("result", type=Path)
    parser.add_argument("--topic", required=True)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--rate", type=float, default=12_000)
    options = parser.parse_args()
    result = ROLES[options.role](process, options)
    partial = options.result.with_suffix(".part")
    partial.write_text(json.dumps(result))
    partial.rename(options.result)


if __name__ == "__main__":
    run("bridge-peer", body, 3.0)
