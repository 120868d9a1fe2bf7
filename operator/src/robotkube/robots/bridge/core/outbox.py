"""The queue of one MQTT connection: batches, bounded, in order, and kept until the broker has them.

A batch leaves the outbox when the broker acknowledged it. After a reconnection everything unacknowledged is sent again
in the old order (receivers drop what they have seen). A broker that lost its sessions acknowledges batches that nobody
has subscribed to yet, and says so: for SETTLING_SECONDS after a reconnection such a batch is kept and tried again, one
at a time, so that the receivers have time to come back and the order stays. Times are seconds of any monotonic clock.

What is beyond the bounds goes, oldest first, and is reported as a gap: topic, reason, number, first and last stamp.
Retained batches do not grow old: they say what is, not what was.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

from robotkube.robots.bridge.core.losses import Losses
from robotkube.robots.mqtt.core.message_properties import GAPS_PER_MESSAGE_MAX
from robotkube.robots.ros.core.gaps import Gap

SETTLING_SECONDS = 10.0
SETTLING_RETRY_SECONDS = 0.2
OLD = "waited too long for the broker"
MANY = "too many waited for the broker"
LARGE = "too many bytes waited for the broker"
REFUSED = "refused by the broker"
CLOSED = "not carried any more"


@dataclass(frozen=True)
class OutgoingBatch:
    """An encoded batch for the MQTT topic `topic`; `messages` is their number in it, `first` and `last` their stamps in
    ns, `born` the time it was put, `name` the ROS topic they come from, empty for what is no message of a robot, `gaps`
    what was given up before it and is reported with it, at most GAPS_PER_MESSAGE_MAX."""

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
class OutboxBounds:
    """Limits of an outbox: age of what waits in seconds, batches, bytes, and batches that are on their way at once."""

    seconds_max: float
    batches_max: int
    bytes_max: int
    inflight_max: int


class Outbox:
    """A queue whose oldest batches go when it is beyond its bounds; `dropped` counts their messages, `losses` says
    which; `where` is what a gap calls this place."""

    def __init__(self, bounds: OutboxBounds, where: str = "mqtt-bridge") -> None:
        self.dropped = 0
        self.losses = Losses()
        self._bounds = bounds
        self._where = where
        self._waiting: deque[OutgoingBatch] = deque()
        self._inflight: dict[int, OutgoingBatch] = {}
        self._bytes = 0
        self._settling_until: float | None = None
        self._connected_before = False
        self._retry_at = 0.0

    def __len__(self) -> int:
        return len(self._waiting) + len(self._inflight)

    @property
    def bytes(self) -> int:
        """The bytes of what waits and is not on its way."""
        return self._bytes

    def put(self, batch: OutgoingBatch) -> None:
        """Add a batch at the end."""
        self._waiting.append(batch)
        self._bytes += len(batch.payload)
        self._bound(batch.born)

    def next(self, now: float) -> OutgoingBatch | None:
        """The batch to send now, with the gaps before it, or None; call `sent` or `give_back` afterwards."""
        self._bound(now)
        if not self._waiting:
            return None
        if self._settling_until is None:
            return self._pop() if len(self._inflight) < self._bounds.inflight_max else None
        if self._inflight or now < self._retry_at:
            return None
        return self._pop()

    @property
    def waiting(self) -> tuple[OutgoingBatch, ...]:
        """The batches that were not sent yet, or have to be sent again."""
        return tuple(self._waiting)

    @property
    def unreported(self) -> list[Gap]:
        """The gaps that no acknowledged batch has reported."""
        return [*(gap for batch in (*self._inflight.values(), *self._waiting) for gap in batch.gaps), *self.losses.open]

    def give_back(self, batch: OutgoingBatch) -> None:
        """Put back `batch`, which `next` returned and which could not be sent."""
        self._waiting.appendleft(batch)
        self._bytes += len(batch.payload)

    def sent(self, token: int, batch: OutgoingBatch) -> None:
        """Note that `batch` is on its way; `token` will come back with its acknowledgement."""
        self._inflight[token] = batch

    def acknowledged(self, token: int, heard: bool, now: float) -> tuple[Gap, ...]:
        """Take out a batch that the broker has; the gaps that were reported with it. `heard`: it has subscribers."""
        batch = self._inflight.pop(token, None)
        if batch is None:
            return ()
        if self._settling_until is not None:
            if heard or now >= self._settling_until:
                self._settling_until = None
            elif not batch.retained:
                self.give_back(batch)
                self._retry_at = now + SETTLING_RETRY_SECONDS
                return ()
        return batch.gaps

    def rejected(self, token: int) -> OutgoingBatch | None:
        """Give up a batch that the broker does not accept; the batch."""
        batch = self._inflight.pop(token, None)
        if batch is not None:
            self._give_up(batch, REFUSED)
        return batch

    def connected(self, now: float) -> None:
        """Begin with a new connection: what was on its way on the old one waits again, in the old order."""
        self.disconnected(now)
        self._settling_until = now + SETTLING_SECONDS if self._connected_before else None
        self._connected_before = True
        self._retry_at = now

    def disconnected(self, now: float) -> None:
        """Let what was on its way wait again, for the connection is gone."""
        self._waiting.extendleft(reversed(self._inflight.values()))
        self._bytes += sum(len(batch.payload) for batch in self._inflight.values())
        self._inflight.clear()
        self._bound(now)

    def forget(self, topic: str) -> None:
        """Drop what waits for a topic that is not carried any more."""
        kept: deque[OutgoingBatch] = deque()
        for batch in self._waiting:
            if batch.topic == topic:
                self._bytes -= len(batch.payload)
                self._give_up(batch, CLOSED)
            else:
                kept.append(batch)
        self._waiting = kept

    def _pop(self) -> OutgoingBatch:
        batch = self._waiting.popleft()
        self._bytes -= len(batch.payload)
        losses = self.losses.close(batch.name) if batch.name else ()
        if not losses:
            return batch
        gaps = (*batch.gaps, *losses)
        for gap in gaps[GAPS_PER_MESSAGE_MAX:]:  # the next batch reports them
            self.losses.reopen(gap)
        return replace(batch, gaps=gaps[:GAPS_PER_MESSAGE_MAX])

    def _bound(self, now: float) -> None:
        while (excess := self._excess(now)) is not None:
            place, why = excess
            batch = self._waiting[place]
            del self._waiting[place]
            self._bytes -= len(batch.payload)
            self._give_up(batch, why)

    def _excess(self, now: float) -> tuple[int, str] | None:
        """Place and reason of the batch that has to go; retained ones only when nothing else is left."""
        waiting = self._waiting
        bounds = self._bounds
        if not waiting:
            return None
        place = 0
        if waiting[0].retained:
            place = next((index for index, batch in enumerate(waiting) if not batch.retained), 0)
        if len(waiting) > bounds.batches_max:
            return place, MANY
        if self._bytes > bounds.bytes_max and len(waiting) > 1:
            return place, LARGE
        oldest = waiting[place]
        return (place, OLD) if not oldest.retained and now - oldest.born > bounds.seconds_max else None

    def _give_up(self, batch: OutgoingBatch, why: str) -> None:
        self.dropped += batch.messages
        for gap in batch.gaps:
            self.losses.reopen(gap)
        if batch.messages and batch.name:
            self.losses.add(Gap(batch.name, self._where, why, batch.messages, batch.first, batch.last))
