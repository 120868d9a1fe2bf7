"""The order in which the connections of a bridge send: one kind of traffic begins nothing while a more urgent one waits
for the network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from robotkube.robots.bridge.core.settings import CHANNELS
from robotkube.robots.bridge.loops.connections import BrokerConnection


class SendingOrder:
    """The strict order of CHANNELS. `yielding`: the connections that had something to send in the last turn and left
    the network to others."""

    def __init__(self) -> None:
        self.yielding: frozenset[str] = frozenset()

    def turn(self, connections: Mapping[str, BrokerConnection], now: float) -> None:
        """Turn all connections, the most urgent first."""
        if len(connections) == 1 and not self.yielding:  # nobody waits for anybody: the bridge of most
            for connection in connections.values():
                connection.turn(now)
            return
        self.yielding = frozenset(self._turned(connections, now))

    def _turned(self, connections: Mapping[str, BrokerConnection], now: float) -> Iterator[str]:
        """Turn them, and name those that yield."""
        urgent: list[BrokerConnection] = []
        for name in CHANNELS:
            connection = connections.get(name)
            if connection is None:
                continue
            waits = bool(urgent) and len(connection.outbox) > 0
            yields = waits and any(one.channel.congested for one in urgent)
            connection.turn(now, yields)
            urgent.append(connection)
            if yields:
                yield name
