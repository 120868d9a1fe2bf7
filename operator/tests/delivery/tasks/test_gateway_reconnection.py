"""The pauses between the attempts of the task gateway's connection: bounded, spread, and those that paho waits."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator

from robotkube.backoffs import Random
from robotkube.delivery.tasks.adapters.paho_gateway import BACKOFF_SECONDS_MAX, BACKOFF_SECONDS_MIN, PahoGateway
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from tests.stages.waiting import until

NEARLY_ONE = 1 - 2**-53


def pauses(jitter: Random, count: int) -> Iterator[float]:
    """The pauses that a gateway asks paho for while no attempt succeeds."""
    gateway = PahoGateway(BrokerAccount("127.0.0.1", 1883, "manager", ""), "manager-gateway", jitter)
    for _ in range(count):
        gateway._failed(None, None)
        yield float(gateway._client._reconnect_min_delay)
        assert gateway._client._reconnect_max_delay == gateway._client._reconnect_min_delay


def test_pauses_grow_to_their_bound() -> None:
    longest = list(pauses(lambda: NEARLY_ONE, 8))
    assert [round(seconds, 6) for seconds in longest] == [1.0, 2.0, 4.0, 8.0, 10.0, 10.0, 10.0, 10.0]
    assert (BACKOFF_SECONDS_MIN, BACKOFF_SECONDS_MAX) == (1.0, 10.0)


def test_two_gateways_do_not_come_back_together() -> None:
    one, other = (list(pauses(random.Random(seed).random, 50)) for seed in (1, 2))  # noqa: S311
    assert all(0.0 <= seconds <= BACKOFF_SECONDS_MAX for seconds in (*one, *other))
    assert not set(one) & set(other)


def test_paho_waits_for_that_and_no_longer() -> None:
    """Without a broker and with pauses of milliseconds, attempts follow each other at once; paho's own take a second
    each, and more."""
    asked: list[int] = []

    def next_to_nothing() -> float:
        asked.append(1)
        return 0.002

    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))  # and does not listen: each attempt is refused
        account = BrokerAccount("127.0.0.1", silent.getsockname()[1], "manager", "")
        gateway = PahoGateway(account, "manager-gateway", next_to_nothing)
        gateway.start(("task/#",))
        try:
            until(lambda: len(asked) >= 20, "twenty attempts", 10)
            assert "does not answer" in gateway.complaint
        finally:
            gateway.close()
