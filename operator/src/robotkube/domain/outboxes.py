"""What waits to be sent over one MQTT connection: bounded, in order, and kept until a subscriber's broker has it.

A frame leaves the outbox when the broker acknowledged it. After a reconnection everything unacknowledged is sent again
in the old order (receivers drop what they have seen). A broker that lost its sessions acknowledges frames that nobody
hears yet, and says so: for SETTLING_SECONDS after a reconnection such a frame is kept and tried again, one at a time,
so that the receivers have time to come back and the order stays. Times are seconds of any monotonic clock.

What is beyond the bounds goes, oldest first, and is told as a gap: topic, reason, number, first and last stamp.
Retained frames do not grow old: they say what is, not what was.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

from robotkube.domain.audits import Gap
from robotkube.domain.bridging_properties import GAPS_PER_MESSAGE_MAX
from robotkube.domain.losses import Losses

SETTLING_SECONDS = 10.0
SETTLING_RETRY_SECONDS = 0.2
OLD, MANY, LARGE, REFUSED, CLOSED = (
    "waited too long for the broker",
    "too many waited for the broker",
    "too many bytes waited for the broker",
    "refused by the broker",
    "not carried any more",
)


@dataclass(frozen=True)
class OutgoingFrame:
    """An encoded frame for the MQTT topic `topic`; `messages` is their number in it, `first` and `last` their stamps in
    ns, `born` the time it was put, `name` the ROS topic they come from, empty for what is no message of a robot, `gaps`
    what was given up before it and is told with it, at most GAPS_PER_MESSAGE_MAX."""

    topic: str
    payload: bytes
    messages: int
    retained: bool = False
    born: float = 0.0
    properties: bytes = b""
    name: str = ""
    first: int = 0
    last: int = 0
    gaps: tuple[Gap, ...] = ()


@dataclass(frozen=True)
class Bounds:
    """Limits of an outbox: age of what waits in seconds, frames, bytes, and frames that are on their way at once."""

    seconds_max: float
    frames_max: int
    bytes_max: int
    inflight_max: int


class Outbox:
    """A queue whose oldest frames go when it is beyond its bounds; `dropped` counts their messages, `losses` tells
    which; `where` is what a gap calls this place."""

    def __init__(self, bounds: Bounds, where: str = "mqtt-bridge") -> None:
        self.dropped, self.losses = 0, Losses()
        self._bounds, self._where = bounds, where
        self._waiting: deque[OutgoingFrame] = deque()
        self._inflight: dict[int, OutgoingFrame] = {}
        self._bytes = 0
        self._settling_until: float | None = None
        self._connected_before = False
        self._retry_at = 0.0

    def __len__(self) -> int:
        return len(self._waiting) + len(self._inflight)

    @property
    def bytes(self) -> int:
        """Bytes of what waits and is not on its way."""
        return self._bytes

    def put(self, frame: OutgoingFrame) -> None:
        """Add a frame at the end."""
        self._waiting.append(frame)
        self._bytes += len(frame.payload)
        self._bound(frame.born)

    def next(self, now: float) -> OutgoingFrame | None:
        """The frame to send now, with the gaps before it, or None; tell `sent` or `give_back` afterwards."""
        self._bound(now)
        if not self._waiting:
            return None
        if self._settling_until is None:
            return self._pop() if len(self._inflight) < self._bounds.inflight_max else None
        if self._inflight or now < self._retry_at:
            return None
        return self._pop()

    @property
    def waiting(self) -> tuple[OutgoingFrame, ...]:
        """What was not sent yet, or has to be sent again."""
        return tuple(self._waiting)

    @property
    def untold(self) -> list[Gap]:
        """Gaps that no acknowledged frame has told."""
        return [*(gap for frame in (*self._inflight.values(), *self._waiting) for gap in frame.gaps), *self.losses.open]

    def give_back(self, frame: OutgoingFrame) -> None:
        """`frame`, which `next` handed out, could not be sent."""
        self._waiting.appendleft(frame)
        self._bytes += len(frame.payload)

    def sent(self, token: int, frame: OutgoingFrame) -> None:
        """`frame` is on its way; `token` will come back with its acknowledgement."""
        self._inflight[token] = frame

    def acknowledged(self, token: int, heard: bool, now: float) -> tuple[Gap, ...]:
        """The broker has a frame; `heard` says whether it has subscribers for it. The gaps that were told with it."""
        frame = self._inflight.pop(token, None)
        if frame is None:
            return ()
        if self._settling_until is not None:
            if heard or now >= self._settling_until:
                self._settling_until = None
            elif not frame.retained:
                self.give_back(frame)
                self._retry_at = now + SETTLING_RETRY_SECONDS
                return ()
        return frame.gaps

    def rejected(self, token: int) -> OutgoingFrame | None:
        """The broker does not take a frame; the frame, which is given up."""
        frame = self._inflight.pop(token, None)
        if frame is not None:
            self._give_up(frame, REFUSED)
        return frame

    def connected(self, now: float) -> None:
        """A connection was made: what was on its way on the old one waits again, in the old order."""
        self.disconnected(now)
        self._settling_until = now + SETTLING_SECONDS if self._connected_before else None
        self._connected_before = True
        self._retry_at = now

    def disconnected(self, now: float) -> None:
        """The connection is gone."""
        self._waiting.extendleft(reversed(self._inflight.values()))
        self._bytes += sum(len(frame.payload) for frame in self._inflight.values())
        self._inflight.clear()
        self._bound(now)

    def forget(self, topic: str) -> None:
        """Drop what waits for a topic that is not carried any more."""
        kept: deque[OutgoingFrame] = deque()
        for frame in self._waiting:
            if frame.topic == topic:
                self._bytes -= len(frame.payload)
                self._give_up(frame, CLOSED)
            else:
                kept.append(frame)
        self._waiting = kept

    def _pop(self) -> OutgoingFrame:
        frame = self._waiting.popleft()
        self._bytes -= len(frame.payload)
        found = self.losses.close(frame.name) if frame.name else ()
        if not found:
            return frame
        gaps = (*frame.gaps, *found)
        for gap in gaps[GAPS_PER_MESSAGE_MAX:]:  # the next frame tells them
            self.losses.reopen(gap)
        return replace(frame, gaps=gaps[:GAPS_PER_MESSAGE_MAX])

    def _bound(self, now: float) -> None:
        while (excess := self._excess(now)) is not None:
            place, why = excess
            frame = self._waiting[place]
            del self._waiting[place]
            self._bytes -= len(frame.payload)
            self._give_up(frame, why)

    def _excess(self, now: float) -> tuple[int, str] | None:
        """Place and reason of the frame that has to go; retained ones only when nothing else is left."""
        waiting, bounds = self._waiting, self._bounds
        if not waiting:
            return None
        place = 0
        if waiting[0].retained:
            place = next((index for index, frame in enumerate(waiting) if not frame.retained), 0)
        if len(waiting) > bounds.frames_max:
            return place, MANY
        if self._bytes > bounds.bytes_max and len(waiting) > 1:
            return place, LARGE
        oldest = waiting[place]
        return (place, OLD) if not oldest.retained and now - oldest.born > bounds.seconds_max else None

    def _give_up(self, frame: OutgoingFrame, why: str) -> None:
        self.dropped += frame.messages
        for gap in frame.gaps:
            self.losses.reopen(gap)
        if frame.messages and frame.name:
            self.losses.add(Gap(frame.name, self._where, why, frame.messages, frame.first, frame.last))
