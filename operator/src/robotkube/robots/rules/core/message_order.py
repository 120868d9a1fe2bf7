"""The order in which rules get messages: that of their stamps, as far as the sources keep it.

Where a source sends out of order, messages of all sources wait until the ones before them are there: the rules look at
the world that much later, all of them, so that what they compare is of one time. Without disorder nothing waits.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import itemgetter

from robotkube.robots.ros.core.source_clocks import SourceClock
from robotkube.robots.rules.core.messages import Message

HELD_MAX = 100_000
"""The most messages that wait; with more of them, none waits any longer."""

TURN_NS = 16_000_000
"""About how often messages are looked at: what is received within it is put in the order of the stamps."""

_stamp = itemgetter(2)


def _turn_and_stamp(message: Message) -> tuple[int, int]:
    return message.received // TURN_NS, message.stamp


class MessageOrder:
    """The messages on their way to the rules. `wait_ns`: how much later than this machine's clock the rules' is now."""

    def __init__(self) -> None:
        self.wait_ns = 0
        self._held: list[Message] = []
        self._disordered: dict[str, SourceClock] = {}

    def note_disorder(self, topic: str, clock: SourceClock, received: int) -> None:
        """Wait for the messages of a source that has just sent one out of order."""
        self._disordered[topic] = clock
        self.wait_ns = max(self.wait_ns, clock.wait_ns(received))

    def due(self, messages: list[Message], now: int) -> Sequence[Message]:
        """The messages that the rules get at `now`, in the order of their stamps; `messages` have just come.

        Of a source that sends out of order, a message counts as received when the fastest ones would have been."""
        if self._disordered:
            self._expect(now)
        if not self.wait_ns or len(self._held) + len(messages) > HELD_MAX:
            return self.all(messages)
        moment = now - self.wait_ns
        due: list[Message] = []
        held: list[Message] = []
        for message in (*self._held, *messages):
            aligned = self._aligned(message)
            if aligned.received <= moment:
                due.append(aligned)
            else:
                held.append(message)
        self._held = held
        return sorted(due, key=_stamp)

    def all(self, messages: Iterable[Message] = ()) -> Sequence[Message]:
        """All messages, those that wait among them, in the order of their stamps; where they would have come one after
        the other, in that order."""
        if not self._held:
            return sorted(messages, key=_stamp)
        every = [self._aligned(message) for message in (*self._held, *messages)]
        self._held = []
        return sorted(every, key=_turn_and_stamp)

    def of(self, topic: str, messages: list[Message], now: int) -> Sequence[Message]:
        """The messages of one topic in the order of their stamps, taken from those that wait and from `messages`.

        They come before it is their turn; so that the time of the others does not go on, they count as received at the
        rules' time."""
        moment = now - self.wait_ns
        every = [self._aligned(message) for message in (*self._held, *messages) if message.topic == topic]
        self._held = [message for message in self._held if message.topic != topic]
        messages[:] = [message for message in messages if message.topic != topic]
        return [message._replace(received=min(message.received, moment)) for message in sorted(every, key=_stamp)]

    def _aligned(self, message: Message) -> Message:
        """The message with the time at which the fastest ones of its source would have been received."""
        clock = self._disordered.get(message.topic)
        received = message.received if clock is None else clock.due(message.stamp, message.received)
        return message if received == message.received else message._replace(received=received)

    def _expect(self, now: int) -> None:
        """Wait for as long as the sources that are out of order need; for one that has kept its order, no more."""
        waits = {topic: clock.wait_ns(now) for topic, clock in self._disordered.items()}
        self._disordered = {topic: self._disordered[topic] for topic, wait in waits.items() if wait}
        self.wait_ns = max(waits.values(), default=0)
