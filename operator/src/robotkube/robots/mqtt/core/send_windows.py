"""How much of one connection may be in the network at once, so that the queue before a narrow uplink stays short.

Everything that a machine sends stands in one queue before its uplink, whatever connection it comes from. A connection
that sends as much as it can fills this queue: with 20 Mbit/s and the usual buffers for seconds, and what is urgent
stands behind it. So a connection that is kept from sending compares its round trip with the shortest there was; what it
is longer is the time in that queue, and the window follows it to QUEUE_SECONDS (as TCP Vegas and FAST do, between
sender and receiver of this connection alone).
"""

from __future__ import annotations

QUEUE_SECONDS = 0.03
"""The time that messages may stand in the queue before the uplink."""
BYTES_MIN, BYTES_MAX = 32 * 1024, 4 * 1024 * 1024
BYTES_FIRST = 64 * 1024
"""What a new connection begins with: 26 ms at 20 Mbit/s."""
CHANGE_MAX = 2.0
PAUSE_SECONDS = 0.1
"""The shortest time between two changes: a round trip must show what the last one did."""


class SendWindow:
    """The window of one connection: `bytes`. It changes only while the connection is kept from sending by it."""

    def __init__(self) -> None:
        self.bytes = BYTES_FIRST
        self._change_at = 0.0

    def due(self, now: float) -> bool:
        """Return whether the window may change again; `now` in seconds of any monotonic clock."""
        return now >= self._change_at

    def change(self, now: float, round_trip: float, shortest: float) -> None:
        """Follow the round trip that was measured, in seconds, and the shortest one of this connection."""
        self._change_at = now + max(PAUSE_SECONDS, 2 * round_trip)
        if round_trip > 0:
            factor = (min(shortest, round_trip) + QUEUE_SECONDS) / round_trip
            wanted = self.bytes * min(max(factor, 1 / CHANGE_MAX), CHANGE_MAX)
            self.bytes = round(min(max(wanted, BYTES_MIN), BYTES_MAX))
