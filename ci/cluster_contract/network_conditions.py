"""What the cable of an agent is like, what was measured of it, and where in the path it acts. Plain values."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NetworkConditions:
    """The conditions of an agent's cable; what is None or 0 is as the machine has it.

    `up_mbit`, `down_mbit`: rate from and to the agent, in 10^6 bits of Ethernet frames a second. `round_trip_ms`: time
    that is added to a round trip, half of it in each direction; it varies by `jitter_ms` to both sides, and packets
    keep their order. `loss_percent`: of the packets of each direction, at random.
    """

    up_mbit: float | None = None
    down_mbit: float | None = None
    round_trip_ms: float = 0.0
    jitter_ms: float = 0.0
    loss_percent: float = 0.0


@dataclass(frozen=True)
class Measured:
    """What a probe measured of a cable. `round_trip_ms`: least, median and greatest; `up_mbit`, `down_mbit`: only where
    a rate was asked for; `sent`, `lost`: the probe's own packets."""

    round_trip_ms: tuple[float, float, float] | None
    up_mbit: float | None
    down_mbit: float | None
    sent: int
    lost: int


@dataclass(frozen=True)
class Traffic:
    """Packets that a direction of a cable has carried: all that came through its rate and its delay, those of them that
    were dropped as lost and as in a hole, and those before that for which its queue had no place."""

    packets: int
    lost: int
    in_holes: int
    queue_full: int
