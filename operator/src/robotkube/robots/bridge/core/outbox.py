"""The queue of one MQTT connection: batches, bounded, in order, and kept until the broker has them.

A batch leaves the outbox when the broker acknowledged it. After a reconnection everything unacknowledged is sent again
in the old order (receivers drop what they have seen). A broker that lost its sessions acknowledges batches that nobody
has subscribed to yet, and says so: for SETTLING_SECONDS after a reconnection such a batch is kept and tried again, one
at a time, so that the receivers have time to come back and the order stays. Times are seconds of any monotonic clock.

What is beyond the bounds goes, oldest first, and so does what is late; it is reported as a gap: topic, reason, number,
first and last stamp. Retained batches do not grow old: they say what is, not what was. A backlog is paced, but for what
has a deadline, which goes first.
"""

from __future__ import annotations

from dataclasses import dataclass

from robotkube.robots.bridge.core.losses import Losses
from robotkube.robots.bridge.core.pacing import Pacing
from robotkube.robots.bridge.core.waiting_batches import OutgoingBatch, WaitingBatches
from robotkube.robots.mqtt.core.message_properties import GAPS_PER_MESSAGE_MAX
from robotkube.robots.ros.core.gaps import Gap

SETTLING_SECONDS = 10.0
SETTLING_RETRY_SECONDS = 0.2
LATE = "later than the deadline"
OLD = "waited too long for the broker"
MANY = "too many waited for the broker"
LARGE = "too many bytes waited for the broker"
REFUSED = "refused by the broker"
CLOSED = "not carried any more"


@dataclass(frozen=True)
class OutboxBounds:
    """Limits of an outbox: age of what waits in seconds, batches, bytes, and batches that are on their way at once.
    `thinned`: too many or too large, the topic with the most bytes loses its oldest batch, else the oldest of all
    goes."""

    seconds_max: float
    batches_max: int
    bytes_max: int
    inflight_max: int
    thinned: bool = False


class Outbox:
    """A queue whose oldest batches go when it is beyond its bounds; `dropped` counts their messages, `losses` says
    which; `where` is what a gap calls this place."""

    def __init__(self, bounds: OutboxBounds, where: str = "mqtt-bridge") -> None:
        self.dropped = 0
        self.losses = Losses()
        self._bounds = bounds
        self._where = where
        self._waiting = WaitingBatches()
        self._inflight: dict[int, OutgoingBatch] = {}
        self._pacing = Pacing()
        self._settling_until: float | None = None
        self._connected_before = False
        self._retry_at = 0.0

    def __len__(self) -> int:
        return self._waiting.count + len(self._inflight)

    @property
    def bytes(self) -> int:
        """The bytes of what waits and is not on its way."""
        return self._waiting.bytes

    @property
    def paced(self) -> bool:
        """Return whether a backlog waits that leaves more slowly than it could."""
        return self._pacing.active

    def put(self, batch: OutgoingBatch) -> None:
        """Add a batch at the end."""
        self._waiting.append(batch)
        self._bound(batch.born)

    def next(self, now: float) -> OutgoingBatch | None:
        """The batch to send now, with the gaps before it, or None; call `sent` or `give_back` afterwards."""
        if self._waiting.count:
            self._bound(now)
        if not self._waiting.count:
            self._pacing.end()
            return None
        inflight_max = self._bounds.inflight_max if self._settling_until is None else 1
        if len(self._inflight) >= inflight_max or (self._settling_until is not None and now < self._retry_at):
            return None
        first = self._waiting.first
        if first.retained or first.deadline_seconds or self._pacing.allows(first.born, now):
            return self._pop()
        return None

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
        self._waiting.put_back([batch])

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
        self._pacing.end()
        self._settling_until = now + SETTLING_SECONDS if self._connected_before else None
        self._connected_before = True
        self._retry_at = now

    def disconnected(self, now: float) -> None:
        """Let what was on its way wait again, for the connection is gone."""
        self._waiting.put_back(list(self._inflight.values()))
        self._inflight.clear()
        self._bound(now)

    def forget(self, topic: str) -> None:
        """Drop what waits for a topic that is not carried any more."""
        for batch in self._waiting.remove_topic(topic):
            self._give_up(batch, CLOSED)

    def _pop(self) -> OutgoingBatch:
        batch = self._waiting.take()
        losses = self.losses.close(batch.name) if batch.name else ()
        if not losses:
            return batch
        gaps = (*batch.gaps, *losses)
        for gap in gaps[GAPS_PER_MESSAGE_MAX:]:  # the next batch reports them
            self.losses.reopen(gap)
        return batch._replace(gaps=gaps[:GAPS_PER_MESSAGE_MAX])

    def _bound(self, now: float) -> None:
        while (excess := self._excess(now)) is not None:
            batch, why = excess
            self._waiting.remove(batch)
            self._give_up(batch, why)

    def _excess(self, now: float) -> tuple[OutgoingBatch, str] | None:
        """The batch that has to go, and the reason."""
        waiting = self._waiting
        bounds = self._bounds
        if not waiting.count:
            return None
        if waiting.late(now):
            return waiting.first, LATE
        many = waiting.count > bounds.batches_max
        if many or (waiting.bytes > bounds.bytes_max and waiting.count > 1):
            return waiting.thickest if bounds.thinned else waiting.oldest, MANY if many else LARGE
        oldest = waiting.oldest
        return (oldest, OLD) if not oldest.retained and now - oldest.born > bounds.seconds_max else None

    def _give_up(self, batch: OutgoingBatch, why: str) -> None:
        self.dropped += batch.messages
        for gap in batch.gaps:
            self.losses.reopen(gap)
        if batch.messages and batch.name:
            self.losses.add(Gap(batch.name, self._where, why, batch.messages, batch.first, batch.last))
