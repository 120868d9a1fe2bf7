"""Takes what it has published itself, in every form in which a subscription gives it; writes what came of it as JSON.

    python -m tests.stages.ros.self_receiver TOPIC FILE

What is published: COUNT short messages, one of LONG_BYTES, then BURSTS of BURST_BYTES whose memory must not stay.
"""

from __future__ import annotations

import json
import os
import resource
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from robotkube.robots.ros.adapters.rclpy_node import MessageIdentity, RosNode, RosPublisher, RosSubscription

COUNT, LONG_BYTES = 10, 1_000_000
BURSTS = 40
BURST = 500
BURST_BYTES = 500 * 1000
TYPE = "std_msgs/msg/UInt8MultiArray"
_HEAD = struct.Struct("<4sIII")
SECONDS_MAX = 20.0


def message(number: int, size: int = 0) -> bytes:
    """An array of bytes: no dimension, `number` as its offset."""
    return _HEAD.pack(b"\0\1\0\0", 0, number, size) + bytes(size)


def number_of(data: bytes) -> int:
    """Which of the messages it is."""
    return int(_HEAD.unpack_from(data)[2])


def main(topic: str, file: Path) -> None:
    """Publish, take, write."""
    node = RosNode("taking")
    publisher = node.advertise(topic, TYPE, depth=1000)
    plain, timed, sent, closed = (node.subscribe(topic, TYPE, depth=1000) for _ in range(4))
    for _ in rounds():
        if publisher.matched == 4:
            break
    results: dict[str, Any] = {"empty": [plain.take(), timed.take_timed(), sent.take_sent()], "began": time.time_ns()}
    for number in range(COUNT):
        publisher.publish(message(number))
    publisher.publish(message(COUNT, LONG_BYTES))
    results["take"] = [[(number_of(data), len(data)) for data in several] for several in _plain(plain)]
    results["take_timed"] = [
        ([(number_of(data), received) for data, received in several], last) for several, last in _timed(timed)
    ]
    results["take_sent"] = [(number_of(data), received, *identity) for data, received, identity in _sent(sent)]
    results["ended"] = time.time_ns()
    results["closed"] = _refusals(closed)
    results["memory"] = _memory(publisher, plain, timed, sent)
    file.write_text(json.dumps(results))
    os._exit(0)


def rounds() -> Iterator[None]:
    """Again and again; ends the process when it takes too long."""
    end = time.monotonic() + SECONDS_MAX
    while time.monotonic() < end:
        yield
        time.sleep(0.005)
    sys.exit("did not happen in time")


def _plain(subscription: RosSubscription) -> list[list[bytes]]:
    received: list[list[bytes]] = []
    for _ in rounds():
        received.append(subscription.take(3))
        if sum(map(len, received)) > COUNT:
            break
    return received


def _timed(subscription: RosSubscription) -> list[tuple[list[tuple[bytes, int]], int | None]]:
    received: list[tuple[list[tuple[bytes, int]], int | None]] = []
    for _ in rounds():
        received.append(subscription.take_timed(4))
        if sum(len(several) for several, _ in received) > COUNT:
            break
    return received


def _sent(subscription: RosSubscription) -> list[tuple[bytes, int, MessageIdentity]]:
    received: list[tuple[bytes, int, MessageIdentity]] = []
    for _ in rounds():
        received += subscription.take_sent()
        if len(received) > COUNT:
            break
    return received


def _refusals(subscription: RosSubscription) -> list[str]:
    subscription.close()
    refusals = []
    for take in (subscription.take, subscription.take_timed, subscription.take_sent):
        try:
            take(1)
        except RuntimeError as error:
            refusals.append(str(error))
    return refusals


def _memory(
    publisher: RosPublisher, plain: RosSubscription, timed: RosSubscription, sent: RosSubscription
) -> list[int]:
    """The process's largest size, bytes, after the first and after the last of many bursts."""
    sizes = []
    for _ in range(BURSTS):
        for number in range(BURST):
            publisher.publish(message(number, BURST_BYTES // BURST))
        counts = [0, 0, 0]
        for _ in rounds():
            several = plain.take(), timed.take_timed()[0], sent.take_sent()
            counts = [count + len(one) for count, one in zip(counts, several, strict=True)]
            if min(counts) >= BURST:
                break
        sizes.append(1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return [sizes[0], sizes[-1]]


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
