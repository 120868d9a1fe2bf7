"""What waits to be sent over one MQTT connection: bounded, in order, and kept until a subscriber's broker has it.

A frame leaves the outbox when the broker acknowledged it. After a reconnection everything unacknowledged is sent again
in the old order (receivers drop what they have seen). A broker that lost its sessions acknowledges frames that nobody
hears yet, and says so: for SETTLING_SECONDS after a reconnection such a frame is kept and tried again, one at a time,
so that the receivers have time to come back and the order stays. Times are seconds of any monotonic clock.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

SETTLING_SECONDS = 10.0
SETTLING_RETRY_SECONDS = 0.2


@dataclass(frozen=True)
class OutgoingFrame:
    """An encoded frame; `messages` is their number in it, `born` the time it was put."""

    topic: str
    payload: bytes
    messages: int
    retained: bool = False
    born: float = 0.0


@dataclass(frozen=True)
class Bounds:
    """Limits of an outbox: age of what waits in seconds, frames, and frames that are on their way at once."""

    seconds_max: float
    frames_max: int
    inflight_max: int


class Outbox:
    """A queue whose oldest frames go when it is beyond its bounds; `dropped` counts their messages."""

    def __init__(self, bounds: Bounds) -> None:
        self.dropped = 0
        self._bounds = bounds
        self._waiting: deque[OutgoingFrame] = deque()
        self._inflight: dict[int, OutgoingFrame] = {}
        self._settling_until: float | None = None
        self._connected_before = False
        self._retry_at = 0.0

    def __len__(self) -> int:
        return len(self._waiting) + len(self._inflight)

    def put(self, frame: OutgoingFrame) -> None:
        """Add a frame at the end."""
        self._waiting.append(frame)
        self._bound(frame.born)

    def next(self, now: float) -> OutgoingFrame | None:
        """The frame to send now, or None; tell `sent` afterwards."""
        if not self._waiting:
            return None
        if self._settling_until is None:
            return self._waiting.popleft() if len(self._inflight) < self._bounds.inflight_max else None
        if self._inflight or now < self._retry_at:
            return None
        return self._waiting.popleft()

    @property
    def waiting(self) -> tuple[OutgoingFrame, ...]:
        """What was not sent yet, or has to be sent again."""
        return tuple(self._waiting)

    def give_back(self, frame: OutgoingFrame) -> None:
        """`frame`, which `next` handed out, could not be sent."""
        self._waiting.appendleft(frame)

    def sent(self, token: int, frame: OutgoingFrame) -> None:
        """`frame` is on its way; `token` will come back with its acknowledgement."""
        self._inflight[token] = frame

    def acknowledged(self, token: int, heard: bool, now: float) -> None:
        """The broker has a frame; `heard` says whether it has subscribers for it."""
        frame = self._inflight.pop(token, None)
        if frame is None or self._settling_until is None:
            return
        if heard or frame.retained or now >= self._settling_until:
            if heard or now >= self._settling_until:
                self._settling_until = None
            return
        self._waiting.appendleft(frame)
        self._retry_at = now + SETTLING_RETRY_SECONDS

    def connected(self, now: float) -> None:
        """A connection was made: what was on its way on the old one waits again, in the old order."""
        self.disconnected(now)
        self._settling_until = now + SETTLING_SECONDS if self._connected_before else None
        self._connected_before = True
        self._retry_at = now

    def disconnected(self, now: float) -> None:
        """The connection is gone."""
        self._waiting.extendleft(reversed(self._inflight.values()))
        self._inflight.clear()
        self._bound(now)

    def forget(self, topic: str) -> None:
        """Drop what waits for a topic that is not carried any more."""
        self._waiting = deque(frame for frame in self._waiting if frame.topic != topic)

    def _bound(self, now: float) -> None:
        waiting, bounds = self._waiting, self._bounds
        while waiting and (len(waiting) > bounds.frames_max or now - waiting[0].born > bounds.seconds_max):
            self.dropped += waiting.popleft().messages
