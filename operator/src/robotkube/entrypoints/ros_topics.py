"""Topics of the ROS graph as a detector sees them."""

from __future__ import annotations

import time
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING

from robotkube.adapters.ros_rclpy import MessageTypeError, RosNode, RosSubscription
from robotkube.domain.detector_settings import TopicSettings
from robotkube.domain.errors import DocumentError, InputError
from robotkube.domain.qualities import Broken, Incompatible, Offer, Quality

if TYPE_CHECKING:
    from robotkube.adapters.ros_rclpy import Sent
    from robotkube.ports.robots import TopicInput

BESIDE_SECONDS = 2.0
"""So long a subscription goes on beside the one that takes its place, of which publishers have to hear first."""
KNOWN_SECONDS, KNOWN_MAX = 3.0, 100_000
"""So long, from its first message on, a subscription remembers what came, and so many messages at most."""

_received = itemgetter(1)


class RosTopics:
    """The ROS graph (port LiveTopics)."""

    def __init__(self, node: RosNode) -> None:
        self._node = node

    def follow(self, topics: Sequence[TopicSettings]) -> None:
        """The graph is there anyway."""

    def subscribe(
        self, topic: str, settings: TopicSettings, quality: Quality, before: TopicInput | None = None
    ) -> RosInput:
        """Subscribe; DocumentError names the topic and what ROS has against it."""
        try:
            subscription = self._node.subscribe(
                topic,
                settings.type,
                quality.reliability,
                quality.durability,
                settings.depth,
                quality.deadline_ns,
                quality.liveliness,
                quality.lease_ns,
            )
        except MessageTypeError as error:
            fix = "install it, or take the topic from the broker (source: mqtt), which carries the definition"
            raise DocumentError(f"topic {topic}", [f"{error}; {fix}"]) from error
        except InputError as error:
            raise DocumentError(f"topic {topic}", [str(error)]) from error
        known = before if isinstance(before, RosInput) else None
        return RosInput(subscription, time.monotonic, time.time_ns, known)

    def visible(self) -> Mapping[str, Sequence[str]]:
        """Topic -> types."""
        return self._node.topics()

    def offers(self, topic: str) -> Sequence[Offer]:
        """Its publishers."""
        return self._node.offers(topic)


class RosInput:
    """A subscription (port TopicInput). It may take the place of another one: for a while both are heard, and what both
    get, or the new one gets again from a publisher that keeps what it said, comes once.

    What the middleware pushed out is seen by the numbers of a single publisher; each of several counts for itself, and
    messages do not say whose they are."""

    def __init__(
        self,
        subscription: RosSubscription,
        monotonic: Callable[[], float],
        clock_ns: Callable[[], int],
        before: RosInput | None = None,
    ) -> None:
        self._subscription, self._before = subscription, before
        self._monotonic, self._clock_ns = monotonic, clock_ns
        self._waiting: list[tuple[bytes, int, Sent]] = []
        self._last, self._alone = -1, False
        self._beside_until, self._known_until = monotonic() + BESIDE_SECONDS, float("inf")
        known = None if before is None else before._known
        self._known: set[Sent] | None = set() if known is None else known
        self.lost: int = 0 if before is None else before.lost

    @property
    def matched(self) -> int:
        """Publishers that are connected now."""
        count = self._subscription.matched
        if count != 1 or not self._alone:
            self._begin_to_count()
        return count

    @property
    def incompatible(self) -> Incompatible:
        """What the middleware said of publishers that it did not connect."""
        return Incompatible(*self._subscription.incompatible)

    @property
    def broken(self) -> Broken:
        """What the middleware said of publishers' promises."""
        return Broken(self._subscription.missed_deadlines, self._subscription.lost_liveliness)

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        """What waits, with the time at which the middleware received it."""
        if self._known is not None:
            return [(data, received) for data, received, _ in self._drain_known(messages_max, self._known)]
        messages, number = self._subscription.take_timed(messages_max)
        if number is not None:
            if number - self._last != len(messages):
                self._count(number, len(messages))
            self._last = number
        return messages

    def close(self) -> None:
        """Unsubscribe."""
        self._subscription.close()
        if self._before is not None:
            self._before.close()

    def _drain_known(self, messages_max: int, known: set[Sent]) -> list[tuple[bytes, int, Sent]]:
        """What waits in the one before, which is never behind, and what only this one got; as it was received.

        What comes while the two are drained waits for the next time: the other one may have got something earlier."""
        now, until = self._monotonic(), self._clock_ns()
        found, self._waiting = self._waiting, []
        beside = self._before
        if beside is not None:
            found += self._drain_before(beside, messages_max, known, now)
        own = self._subscription.take_sent(messages_max)
        if own and own[-1][2].number is not None:
            self._count(own[-1][2].number, len(own))
        found += [one for one in own if one[2] not in known or one[2].number is None]
        known.update(sent for *_, sent in own)
        if own:
            self._known_until = min(self._known_until, now + KNOWN_SECONDS)
        if now > self._known_until or len(known) > KNOWN_MAX:
            self._known = None
            found += self._leave_before()
        if beside is not None:
            found.sort(key=_received)
            ready = bisect_right(found, until, key=_received) if self._known is not None else len(found)
            found, self._waiting = found[:ready], found[ready:]
        return found

    def _drain_before(
        self, before: RosInput, messages_max: int, known: set[Sent], now: float
    ) -> list[tuple[bytes, int, Sent]]:
        lost = before.lost
        found = before._drain_known(messages_max, known)
        self.lost += before.lost - lost
        if now > self._beside_until:
            found += self._leave_before()
        return found

    def _leave_before(self) -> list[tuple[bytes, int, Sent]]:
        """Close the one before; what waits in it."""
        if self._before is None:
            return []
        waiting = self._before._waiting
        self._before.close()
        self._before = None
        self._begin_to_count()
        return waiting

    def _begin_to_count(self) -> None:
        """Whose number the last one was is not known."""
        self._last, self._alone = -1, False

    def _count(self, number: int, taken: int) -> None:
        """Go on with the number of the last one taken; while there is one before, that one counts what is lost."""
        missing = number - self._last - taken
        if missing:  # rarely: publishers are looked at only then
            alone = self.matched == 1
            self.lost += max(missing, 0) if self._alone and self._before is None else 0
            self._alone = alone
        self._last = number
