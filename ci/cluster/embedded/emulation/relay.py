"""`python -m ci.cluster.embedded.emulation.relay`: carries packets between the ends of two cables, each after its
delay.

A process of the host, for kernels without netem. It carries whole Ethernet frames, so connections end at their own
ends: a sender sees the round trip, and what is lost behind is sent again by it. Frames come as the kernel has them
(PACKET_VNET_HDR): large ones in one piece, with a checksum that is still to be made. Its settings:

    {"cables": [{"near": "rk-demo-2", "far": "rk-demo-e2", "delay_ms": 25, "jitter_ms": 7.5}]}
"""

from __future__ import annotations

import argparse
import json
import random
import select
import signal
import socket
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ci.cluster.embedded.emulation.delays import DelayedQueue, VaryingDelay
from ci.cluster.embedded.host import followers
from ci.cluster.embedded.host.records import ClusterFolders

NAME = "network-relay"
MODULE = "ci.cluster.embedded.emulation.relay"
FRAME_BYTES_MAX = 80_000  # a header of the kernel's, of Ethernet, and the largest packet
WAITING_BYTES_MAX = 64 * 2**20  # of a direction
SOCKET_BYTES = 8 * 2**20
PACKETS_AT_ONCE = 64
REPORT_SECONDS = 0.5
EVERY_PROTOCOL = 0x0003
SOL_PACKET, PACKET_STATISTICS, PACKET_VNET_HDR, PACKET_IGNORE_OUTGOING = 263, 6, 15, 23
SO_SNDBUFFORCE, SO_RCVBUFFORCE = 32, 33


@dataclass(frozen=True)
class RelayReport:
    """What the relay has done: that it runs, and how many packets it lost because it had no place or no time."""

    running: bool = True
    dropped: int = 0


@dataclass
class Direction:
    """One direction of a cable: from where packets come, where they go, and those that wait."""

    source: socket.socket
    target: socket.socket
    queue: DelayedQueue
    unread: int = 0

    def receive(self, clock: float) -> None:
        """Take what has come."""
        for _ in range(PACKETS_AT_ONCE):
            try:
                data = self.source.recv(FRAME_BYTES_MAX)
            except BlockingIOError:
                return
            self.queue.put(data, clock)

    def send(self, clock: float) -> None:
        """Send what is due; what the cable does not take is lost, as it would be there."""
        while (data := self.queue.due(clock)) is not None:
            try:
                self.target.send(data)
            except OSError:
                self.queue.dropped += 1

    def dropped(self) -> int:
        """The packets that were lost here: without a place in the queue, or unread when the socket was full."""
        statistics = self.source.getsockopt(SOL_PACKET, PACKET_STATISTICS, 8)
        self.unread += int.from_bytes(statistics[4:8], "little")
        return self.unread + self.queue.dropped


def frames_of(end: str) -> socket.socket:
    """A socket with every frame that comes in at an end of a cable."""
    made = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
    made.setblocking(False)
    made.setsockopt(SOL_PACKET, PACKET_VNET_HDR, 1)
    made.setsockopt(SOL_PACKET, PACKET_IGNORE_OUTGOING, 1)
    for option in (SO_SNDBUFFORCE, SO_RCVBUFFORCE):
        made.setsockopt(socket.SOL_SOCKET, option, SOCKET_BYTES)
    made.bind((end, EVERY_PROTOCOL))
    return made


def directions(cables: Sequence[Mapping[str, Any]]) -> list[Direction]:
    """Both directions of every cable."""
    both_ways = []
    for cable in cables:
        near, far = frames_of(cable["near"]), frames_of(cable["far"])
        for source, target in ((near, far), (far, near)):
            delay = VaryingDelay(cable["delay_ms"] / 1000, cable["jitter_ms"] / 1000, random.random)
            both_ways.append(Direction(source, target, DelayedQueue(delay, WAITING_BYTES_MAX)))
    return both_ways


def turn(by_source: Mapping[socket.socket, Direction], seconds: float) -> None:
    """Wait until a packet comes or is due, at most so long; take what came and send what is due."""
    dues = [due for one in by_source.values() if (due := one.queue.next_due) is not None]
    left = min([seconds, *(due - time.monotonic() for due in dues)])
    readable, _, _ = select.select([*by_source], [], [], max(0.0, left))
    now = time.monotonic()
    for source in readable:
        by_source[source].receive(now)
    for one in by_source.values():
        one.send(now)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m ci.cluster.embedded.emulation.relay", description=__doc__)
    parser.add_argument("--name", required=True, help="of the cluster")
    folders = ClusterFolders(parser.parse_args().name)
    settings = json.loads((folders.base / f"{NAME}.settings.json").read_text(encoding="utf-8"))
    by_source = {direction.source: direction for direction in directions(settings["cables"])}
    reported = None
    due = 0.0
    stopping = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopping.set())
    while not stopping.is_set():
        if time.monotonic() >= due:
            due = time.monotonic() + REPORT_SECONDS
            report = RelayReport(dropped=sum(one.dropped() for one in by_source.values()))
            if report != reported:
                followers.keep_report(folders, NAME, report)
                reported = report
        turn(by_source, due - time.monotonic())


if __name__ == "__main__":
    main()
