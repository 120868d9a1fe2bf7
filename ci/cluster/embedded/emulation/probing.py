"""What a probe measures of cables: round trips, rates and losses of its own packets (UDP), between the network
namespace of an agent's node and that of the node where the platform runs. Pods take the same path.

Round trips of all cables are measured at the same time, rates one after the other, so that they do not take each
other's processor.
"""

from __future__ import annotations

import select
import socket
import statistics
import struct
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ci.cluster.embedded.network.namespaces import inside
from ci.cluster_contract.network_conditions import Measured, NetworkConditions

ROUND_TRIPS = 100
PAUSE_SECONDS = 0.01
ANSWER_SECONDS_MAX = 2.0  # of the last round trip; also how long a silent cable is listened to
FLOOD_SECONDS = 1.2
RATE_AFTER_SECONDS = 0.3  # so long a rate settles
SPAN_SECONDS_MIN = 0.4  # what arrived in less says nothing of a rate
FLOOD_SHARE = 1.25  # of the rate that was asked for: more than the cable takes, less than its queue holds
QUIET_SECONDS = 0.3
PAYLOAD_BYTES = 1400
FRAME_BYTES = 1400 + 8 + 20 + 14
SOCKET_BYTES = 8 * 2**20
SO_SNDBUFFORCE, SO_RCVBUFFORCE, SO_TIMESTAMPNS = 32, 33, 35
NUMBER = struct.Struct("!I")
TIMESTAMP = struct.Struct("@qq")


@dataclass(frozen=True)
class Ends:
    """The ends of the path: the network namespaces of the agent's node and of the other one, with their addresses."""

    near: Path
    near_address: str
    far: Path
    far_address: str


@dataclass
class _RoundTrips:
    near: socket.socket
    far: socket.socket
    sent: list[float] = field(default_factory=list)
    stayed: dict[int, float] = field(default_factory=dict)
    seconds: dict[int, float] = field(default_factory=dict)


def probe(ends: Mapping[str, Ends], conditions: Mapping[str, NetworkConditions]) -> Mapping[str, Measured]:
    """Measure the cables of these agents."""
    trips = round_trips([*ends.values()])
    return {agent: _probed(ends[agent], conditions[agent], trip) for agent, trip in zip(ends, trips, strict=True)}


def _probed(ends: Ends, asked: NetworkConditions, trips: Sequence[float | None]) -> Measured:
    known = sorted(1000 * seconds for seconds in trips if seconds is not None)
    sent = len(trips)
    lost = len(trips) - len(known)
    rates: list[float | None] = []
    for mbit, upwards in ((asked.up_mbit, True), (asked.down_mbit, False)):
        rate = flood(ends, mbit, upwards) if mbit else None
        rates.append(rate.mbit if rate else None)
        sent, lost = (sent + rate.sent, lost + rate.lost) if rate else (sent, lost)
    middle = (known[0], known[len(known) // 2], known[-1]) if known else None
    return Measured(middle, rates[0], rates[1], sent, lost)


def round_trips(ends: Sequence[Ends]) -> list[list[float | None]]:
    """The times of ROUND_TRIPS packets there and back on every cable, in seconds; None: one of the two was lost. What
    this process takes to answer is not in them."""
    probes = [_RoundTrips(*_pair(end)) for end in ends]
    by_socket = {one.near: one for one in probes} | {one.far: one for one in probes}
    begun = time.time()
    number = 0
    while number < ROUND_TRIPS or time.time() < probes[0].sent[-1] + ANSWER_SECONDS_MAX:
        if number < ROUND_TRIPS and time.time() >= begun + number * PAUSE_SECONDS:
            for one in probes:
                one.sent.append(time.time())
                one.near.send(NUMBER.pack(number))
            number += 1
        if all(len(one.seconds) == ROUND_TRIPS for one in probes):
            break
        left = begun + number * PAUSE_SECONDS - time.time() if number < ROUND_TRIPS else PAUSE_SECONDS
        for ready in select.select([*by_socket], [], [], max(0.0, left))[0]:
            _answer(ready, by_socket[ready])
    for opened in by_socket:
        opened.close()
    return [[one.seconds.get(number) for number in range(ROUND_TRIPS)] for one in probes]


def _answer(ready: socket.socket, one: _RoundTrips) -> None:
    data, arrived = _received(ready)
    [number] = NUMBER.unpack(data)
    if ready is one.far:
        one.stayed[number] = time.time() - arrived
        one.far.send(data)
    else:
        one.seconds[number] = arrived - one.sent[number] - one.stayed[number]


def _received(opened: socket.socket) -> tuple[bytes, float]:
    """A packet, and when the kernel had it, in seconds since 1970."""
    data, ancillary, _, _ = opened.recvmsg(PAYLOAD_BYTES, socket.CMSG_SPACE(TIMESTAMP.size))
    [(_, _, stamp)] = ancillary
    seconds, nanoseconds = TIMESTAMP.unpack(stamp[: TIMESTAMP.size])
    return data, seconds + nanoseconds / 1e9


@dataclass(frozen=True)
class Flood:
    """What came of packets that were sent faster than a cable takes them."""

    mbit: float | None
    sent: int
    lost: int


def flood(ends: Ends, mbit: float, upwards: bool) -> Flood:
    """Send more than `mbit` for FLOOD_SECONDS, and see how much arrives in a second, as Ethernet frames on the wire."""
    near, far = _pair(ends)
    source, target = (near, far) if upwards else (far, near)
    pause = FRAME_BYTES * 8 / (FLOOD_SHARE * mbit * 1e6)
    arrivals: list[float] = []
    begun = heard = time.monotonic()
    sent = 0
    while (now := time.monotonic()) < begun + FLOOD_SECONDS or now < heard + QUIET_SECONDS:
        while now < begun + FLOOD_SECONDS and sent * pause <= now - begun and _sent(source):
            sent += 1
        if select.select([target], [], [], min(0.002, pause))[0]:
            heard = time.monotonic()
            arrivals += _arrived(target)
    for opened in (near, far):
        opened.close()
    return Flood(_mbit(arrivals), sent, sent - len(arrivals))


def _sent(source: socket.socket) -> bool:
    """Return whether the cable took one more packet; else its queue is full of them."""
    try:
        source.send(bytes(PAYLOAD_BYTES))
    except BlockingIOError:
        return False
    return True


def _arrived(target: socket.socket) -> list[float]:
    """The times at which the kernel had each of the packets that wait now."""
    return list(iter(lambda: _next_arrival(target), None))


def _next_arrival(target: socket.socket) -> float | None:
    try:
        return _received(target)[1]
    except BlockingIOError:
        return None


def _mbit(arrivals: Sequence[float]) -> float | None:
    """The rate of what arrived after the first moments: the slope of the number of packets over time, so that packets
    that come together at the beginning or the end, after somebody had no processor, weigh little. None when there is
    too little."""
    settled = [moment for moment in arrivals if moment >= arrivals[0] + RATE_AFTER_SECONDS]
    if not settled or settled[-1] - settled[0] < SPAN_SECONDS_MIN:
        return None
    return statistics.linear_regression(settled, range(len(settled))).slope * FRAME_BYTES * 8 / 1e6


def _pair(ends: Ends) -> tuple[socket.socket, socket.socket]:
    """Two sockets that speak with each other alone: of the agent's node, and of the other one."""
    near, far = inside(ends.near, _udp), inside(ends.far, _udp)
    near.bind((ends.near_address, 0))
    far.bind((ends.far_address, 0))
    near.connect(far.getsockname())
    far.connect(near.getsockname())
    return near, far


def _udp() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    made.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    for option in (SO_SNDBUFFORCE, SO_RCVBUFFORCE):
        made.setsockopt(socket.SOL_SOCKET, option, SOCKET_BYTES)
    return made
