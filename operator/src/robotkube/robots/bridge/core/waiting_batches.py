"""Batches that wait to be sent: those with a deadline go before those without, and both in the order in which they
came.

So a backlog never makes messages late that have a deadline. The messages of one topic keep their order, since either
all or none of them have a deadline.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

from robotkube.robots.ros.core.gaps import Gap


class OutgoingBatch(NamedTuple):
    """An encoded batch for the MQTT topic `topic`; `messages` is their number in it, `first` and `last` their stamps in
    ns, `born` the time it was put, `name` the ROS topic they come from, empty for what is no message of a robot, `gaps`
    what was given up before it and is reported with it, at most GAPS_PER_MESSAGE_MAX. It is late `deadline_seconds`
    after `born`; 0: never, as every retained one, which says what is, not what was."""

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
    deadline_seconds: float = 0.0


class WaitingBatches:
    """Two queues, with and without deadlines; `count` batches, whose payloads have `bytes`."""

    def __init__(self) -> None:
        self.count = self.bytes = 0
        self._dated: deque[OutgoingBatch] = deque()
        self._undated: deque[OutgoingBatch] = deque()

    def __iter__(self) -> Iterator[OutgoingBatch]:
        return chain(self._dated, self._undated)

    def append(self, batch: OutgoingBatch) -> None:
        """Add a batch at the end."""
        self._queue(batch).append(batch)
        self.count += 1
        self.bytes += len(batch.payload)

    def put_back(self, batches: Sequence[OutgoingBatch]) -> None:
        """Let batches that came before all others wait again, in their order."""
        for batch in reversed(batches):
            self._queue(batch).appendleft(batch)
            self.count += 1
            self.bytes += len(batch.payload)

    @property
    def first(self) -> OutgoingBatch:
        """The batch that goes next, of at least one."""
        return (self._dated or self._undated)[0]

    def late(self, now: float) -> bool:
        """Return whether the batch that goes next has a deadline that has passed."""
        return bool(self._dated) and now - self._dated[0].born > self._dated[0].deadline_seconds

    def take(self) -> OutgoingBatch:
        """Take out the batch that goes next, of at least one."""
        batch = (self._dated or self._undated).popleft()
        self.count -= 1
        self.bytes -= len(batch.payload)
        return batch

    def remove(self, batch: OutgoingBatch) -> None:
        """Take out any batch."""
        self._queue(batch).remove(batch)
        self.count -= 1
        self.bytes -= len(batch.payload)

    def remove_topic(self, topic: str) -> list[OutgoingBatch]:
        """Take out all batches of an MQTT topic; these, in their order."""
        removed = [batch for batch in self if batch.topic == topic]
        self._dated = deque(batch for batch in self._dated if batch.topic != topic)
        self._undated = deque(batch for batch in self._undated if batch.topic != topic)
        self.count -= len(removed)
        self.bytes -= sum(len(batch.payload) for batch in removed)
        return removed

    @property
    def oldest(self) -> OutgoingBatch:
        """The batch that came first, of at least one; a retained one only when nothing else is left."""
        if not self._dated and not self._undated[0].retained:
            return self._undated[0]
        queues = (self._dated, self._undated)
        heads = [next((batch for batch in queue if not batch.retained), None) for queue in queues]
        return min((head for head in heads if head is not None), key=lambda head: head.born, default=self.first)

    @property
    def thickest(self) -> OutgoingBatch:
        """The oldest batch of the topic that has the most bytes here, so that topics are thinned that need it; of at
        least one, a retained one only when nothing else is left."""
        sizes: Counter[str] = Counter()
        for batch in self:
            sizes[batch.topic] += 0 if batch.retained else len(batch.payload)
        topic = max(sizes, key=sizes.__getitem__)
        batches = (batch for batch in self if batch.topic == topic and not batch.retained)
        return next(batches, self.first)

    def _queue(self, batch: OutgoingBatch) -> deque[OutgoingBatch]:
        return self._dated if batch.deadline_seconds else self._undated
