"""A broker that does not answer is asked again after pauses that differ from process to process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

from robotkube.delivery.rights.core.accounts import Accounts
from robotkube.delivery.rights.loops.keeper import Keeper
from robotkube.errors import UnavailableError


class SilentBroker:
    """Port BrokerControl: a connection that stands, and no answers; `asked` has when it was asked."""

    connections = 1
    complaint = None

    def __init__(self) -> None:
        self.now = 0.0
        self.asked: list[float] = []

    def turn(self) -> None:
        pass

    def ask(self, requests: Sequence[Mapping[str, Any]]) -> Sequence[Mapping[str, Any]]:
        self.asked.append(self.now)
        raise UnavailableError("the broker is silent")

    def close(self) -> None:
        pass


def asked_at(jitter: float) -> list[float]:
    """The times of the first five questions, with turns of a tenth of a second."""
    broker = SilentBroker()
    follower: Any = SimpleNamespace(table=SimpleNamespace(table={}))
    keeper = Keeper(broker, lambda: follower, Accounts((), ()), lambda: broker.now, lambda: jitter)
    keeper._connections = broker.connections  # as after a connection whose table was compared once
    while len(broker.asked) < 5:
        keeper.step()
        broker.now = round(broker.now + 0.1, 1)
    return broker.asked


def test_pauses_grow_to_their_bound() -> None:
    assert asked_at(0.5) == [0.0, 0.5, 1.5, 2.5, 3.5]


def test_two_processes_do_not_come_back_together() -> None:
    assert asked_at(0.25) == [0.0, 0.3, 0.8, 1.3, 1.8]
