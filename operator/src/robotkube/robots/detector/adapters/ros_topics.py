"""Topics of the ROS graph as inputs of a detector."""

from __future__ import annotations

import time
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING

from robotkube.errors import DocumentError, InputError
from robotkube.robots.detector.core.settings import MISSING_TYPE_FIX, TopicSettings
from robotkube.robots.ros.adapters.rclpy_node import MessageTypeError, RosNode, RosSubscription
from robotkube.robots.ros.core.qos import IncompatiblePublishers, PublisherOffer, QosProfile, QosViolations

if TYPE_CHECKING:
    from robotkube.robots.detector.ports import TopicInput
    from robotkube.robots.ros.adapters.rclpy_node import MessageIdentity

BESIDE_SECONDS = 2.0
"""The time for which a subscription goes on beside the one that takes its place, which publishers discover first."""
KNOWN_SECONDS = 3.0
"""The time, from its first message on, for which a subscription remembers the messages that came."""
KNOWN_MAX = 100_000  # remembered messages

_received = itemgetter(1)


class RosTopics:
    """The ROS graph (port LiveTopics)."""

    def __init__(self, node: RosNode) -> None:
        self._node = node

    def announce(self, topics: Sequence[TopicSettings]) -> None:
        """See the port: nothing is to be done, since the graph shows all topics."""

    def subscribe(
        self, topic: str, settings: TopicSettings, qos: QosProfile, before: TopicInput | None = None
    ) -> RosInput:
        """Subscribe; DocumentError names the topic and what ROS has against it."""
        try:
            subscription = self._node.subscribe(
                topic,
                settings.type,
                qos.reliability,
                qos.durability,
                settings.depth,
                qos.deadline_ns,
                qos.liveliness,
                qos.lease_ns,
            )
        except MessageTypeError as error:
            raise DocumentError(f"topic {topic}", [f"{error}; {MISSING_TYPE_FIX}"]) from error
        except InputError as error:
            raise DocumentError(f"topic {topic}", [str(error)]) from error
        known = before if isinstance(before, RosInput) else None
        return RosInput(subscription, time.monotonic, time.time_ns, known)

    def visible(self) -> Mapping[str, Sequence[str]]:
        """See the port."""
        return self._node.topics()

    def offers(self, topic: str) -> Sequence[PublisherOffer]:
        """See the port."""
        return self._node.offers(topic)


class RosInput:
    """A ROS subscription (port TopicInput), which may take the place of another one.

    For a while both receive, and a message that both get, or that the new one gets again from a latching publisher,
    is given once. Messages that the middleware pushed out show by the numbers of a single publisher; of several, each
    counts for itself, and a message does not say whose it is."""

    def __init__(
        self,
        subscription: RosSubscription,
        monotonic: Callable[[], float],
        clock_ns: Callable[[], int],
        before: RosInput | None = None,
    ) -> None:
        self._subscription = subscription
        self._before = before
        self._monotonic = monotonic
        self._clock_ns = clock_ns
        self._waiting: list[tuple[bytes, int, MessageIdentity]] = []
        self._last = -1
        self._alone = False
        self._beside_until = monotonic() + BESIDE_SECONDS
        self._known_until = float("inf")
        known = None if before is None else before._known
        self._known: set[MessageIdentity] | None = set() if known is None else known
        self.lost: int = 0 if before is None else before.lost

    @property
    def matched(self) -> int:
        """The number of publishers that are connected now."""
        count = self._subscription.matched
        if count != 1 or not self._alone:
            self._begin_to_count()
        return count

    @property
    def incompatible(self) -> IncompatiblePublishers:
        """The publishers that the middleware did not connect."""
        return IncompatiblePublishers(*self._subscription.incompatible)

    @property
    def violations(self) -> QosViolations:
        """The violations of publishers' promises that the middleware counted."""
        return QosViolations(self._subscription.missed_deadlines, self._subscription.lost_liveliness)

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        """The messages that wait, each with the time at which the middleware received it."""
        if self._known is not None:
            return [(data, received) for data, received, _ in self._drain_known(messages_max, self._known)]
        messages, number = self._subscription.take_timed(messages_max)
        if number is not None:
            if number - self._last != len(messages):
                self._count(number, len(messages))
            self._last = number
        return messages

    def close(self) -> None:
        """End the subscription."""
        self._subscription.close()
        if self._before is not None:
            self._before.close()

    def _drain_known(self, messages_max: int, known: set[MessageIdentity]) -> list[tuple[bytes, int, MessageIdentity]]:
        """The messages of the former subscription, which is never behind, and those that only this one got, in their
        order.

        Messages that come while the two are drained wait for the next call: the other may have got an earlier one."""
        now = self._monotonic()
        until = self._clock_ns()
        messages, self._waiting = self._waiting, []
        beside = self._before
        if beside is not None:
            messages += self._drain_before(beside, messages_max, known, now)
        own = self._subscription.take_sent(messages_max)
        if own and own[-1][2].number is not None:
            self._count(own[-1][2].number, len(own))
        messages += [message for message in own if message[2] not in known or message[2].number is None]
        known.update(sent for *_, sent in own)
        if own:
            self._known_until = min(self._known_until, now + KNOWN_SECONDS)
        if now > self._known_until or len(known) > KNOWN_MAX:
            self._known = None
            messages += self._leave_before()
        if beside is not None:
            messages.sort(key=_received)
            ready = bisect_right(messages, until, key=_received) if self._known is not None else len(messages)
            messages, self._waiting = messages[:ready], messages[ready:]
        return messages

    def _drain_before(
        self, before: RosInput, messages_max: int, known: set[MessageIdentity], now: float
    ) -> list[tuple[bytes, int, MessageIdentity]]:
        lost = before.lost
        messages = before._drain_known(messages_max, known)
        self.lost += before.lost - lost
        if now > self._beside_until:
            messages += self._leave_before()
        return messages

    def _leave_before(self) -> list[tuple[bytes, int, MessageIdentity]]:
        """Close the former subscription; returns the messages that wait in it."""
        if self._before is None:
            return []
        waiting = self._before._waiting
        self._before.close()
        self._before = None
        self._begin_to_count()
        return waiting

    def _begin_to_count(self) -> None:
        """Forget the last number, since its publisher is not known."""
        self._last = -1
        self._alone = False

    def _count(self, number: int, taken: int) -> None:
        """Count the lost messages up to the last number; while there is a former subscription, that one counts them."""
        missing = number - self._last - taken
        if missing:  # rarely: publishers are counted only then
            alone = self.matched == 1
            self.lost += max(missing, 0) if self._alone and self._before is None else 0
            self._alone = alone
        self._last = number
