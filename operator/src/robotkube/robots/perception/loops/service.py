"""The common part of object-detection and object-tracking: one input topic, outputs per message, counters.

`turn` works off what waits and never blocks. A message that cannot be read is counted and left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robotkube.errors import InputError, UnavailableError

if TYPE_CHECKING:
    from robotkube.robots.ros.ports import MessageSink, MessageSource, RobotNetwork

MESSAGES_PER_TURN_MAX = 20

Log = Callable[..., None]
Topic = tuple[str, str]
"""A topic's name and type."""


class MessageProcessor:
    """Subscribes to one topic and publishes what `work` makes of each message, by output topic.

    `work` raises ValueError for what it cannot read. All methods belong to one thread but `complaint` and `metrics`.
    """

    def __init__(self, name: str, network: RobotNetwork, log: Log) -> None:
        self._name = name
        self._network = network
        self._log = log
        self._source: MessageSource | None = None
        self._sinks: dict[str, MessageSink] = {}
        self._work: Callable[[bytes], Mapping[str, bytes]] = lambda data: {}
        self.received = self.malformed = self.lost = 0
        self.complaint: str | None = "no settings yet"

    def open(
        self, source: Topic, sinks: Sequence[Topic], work: Callable[[bytes], Mapping[str, bytes]], depth: int
    ) -> None:
        """Work with these topics from now on; what was open before is closed. `complaint` says what was refused."""
        self.close()
        try:
            self._sinks = {topic: self._network.advertise(topic, kind, depth=depth) for topic, kind in sinks}
            self._source = self._network.subscribe(*source, depth=depth)
        except InputError as error:
            self.complaint = str(error)
            self._log("topics refused", error=str(error))
            return
        self._work = work
        self.complaint = None

    def close(self) -> None:
        """Close all topics."""
        for endpoint in (self._source, *self._sinks.values()):
            if endpoint is not None:
                endpoint.close()
        self._source = None
        self._sinks = {}

    def turn(self) -> int:
        """Work off what arrived; the number of messages."""
        messages = self._source.take(MESSAGES_PER_TURN_MAX) if self._source is not None else []
        for data in messages:
            self._receive(data)
        return len(messages)

    def _receive(self, data: bytes) -> None:
        self.received += 1
        try:
            results = self._work(data)
        except ValueError as error:
            self.malformed += 1
            if self.malformed == 1:
                self._log("message left out", error=str(error))
            return
        for topic, result in results.items():
            try:
                self._sinks[topic].publish(result)
            except UnavailableError:
                self.lost += 1

    def metrics(self) -> str:
        """The counters in Prometheus' text format."""
        counts: Mapping[str, Any] = {"received": self.received, "malformed": self.malformed, "lost": self.lost}
        prefix = f"robotkube_{self._name}"
        return "".join(
            f"# TYPE {prefix}_{key}_messages_total counter\n{prefix}_{key}_messages_total {value}\n"
            for key, value in counts.items()
        )
