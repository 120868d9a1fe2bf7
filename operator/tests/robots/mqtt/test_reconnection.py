"""The pauses between the attempts of an MQTT connection: bounded, spread, and over soon after the broker is back."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from statistics import fmean

import pytest

from robotkube.backoffs import Random, backoff
from robotkube.errors import InputError
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import BACKOFF_SECONDS_MAX, BACKOFF_SECONDS_MIN, PahoChannel
from tests.stages.channel_events import KeptEvents

FIXED_SECONDS_MAX = 5.0
"""The longest of the fixed pauses that jitter replaced: they doubled from BACKOFF_SECONDS_MIN, the same for all."""
NEARLY_ONE = 1 - 2**-53
OUTAGES = 2000
WAIT_SECONDS = 30.0


def no_account() -> BrokerAccount:
    """The account of a robot without the Secret: an attempt fails at once."""
    raise InputError("no Secret")


def pauses(jitter: Random, count: int) -> Iterator[float]:
    """The pauses of a channel whose attempts all fail, on a clock that goes on by milliseconds."""
    channel = PahoChannel(no_account, "vehicle-00-telemetry", 60, KeptEvents(), jitter)
    milliseconds = begin = 0
    for _ in range(count + 1):
        while channel._attempt is None:
            channel.turn(milliseconds / 1000)
            milliseconds += 1
        if begin:
            yield (milliseconds - begin) / 1000
        deadline = time.monotonic() + WAIT_SECONDS
        while channel._attempt is not None:
            assert time.monotonic() < deadline, "the attempt did not end"
            channel.turn(milliseconds / 1000)
        begin = milliseconds


def returns(outage: float, maximum: float, jitter: Random) -> float:
    """Seconds from the end of an outage to the attempt that succeeds, of attempts that cost no time."""
    elapsed = 0.0
    attempt = 0
    while elapsed < outage:
        elapsed += backoff(attempt, BACKOFF_SECONDS_MIN, maximum, jitter)
        attempt += 1
    return elapsed - outage


def test_the_pauses_double_up_to_one_second() -> None:
    assert list(pauses(lambda: NEARLY_ONE, 6)) == pytest.approx([0.2, 0.4, 0.8, 1.0, 1.0, 1.0], abs=0.002)


def test_the_pauses_of_two_robots_differ() -> None:
    first, second = (list(pauses(random.Random(seed).random, 5)) for seed in (1, 2))  # noqa: S311  # any spread
    assert all(abs(one - other) > 0.002 for one, other in zip(first, second, strict=True))


@pytest.mark.parametrize("outage", [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0])
def test_a_robot_is_back_no_later_than_with_the_fixed_pauses(outage: float) -> None:
    source = random.Random(7)  # noqa: S311  # any spread
    outages = [outage * source.uniform(0.7, 1.4) for _ in range(OUTAGES)]
    jittered = [returns(seconds, BACKOFF_SECONDS_MAX, source.random) for seconds in outages]
    fixed = [returns(seconds, FIXED_SECONDS_MAX, lambda: 1.0) for seconds in outages]
    assert fmean(jittered) < fmean(fixed)
    assert max(jittered) <= max(BACKOFF_SECONDS_MAX, max(fixed))
    assert outage < 2 or max(jittered) < max(fixed)


def test_a_fleet_comes_back_spread_over_the_whole_second() -> None:
    source = random.Random(7)  # noqa: S311  # any spread
    moments = [returns(20.0, BACKOFF_SECONDS_MAX, source.random) for _ in range(OUTAGES)]
    tenths = [sum(low <= 10 * moment < low + 1 for moment in moments) / OUTAGES for low in range(10)]
    assert max(tenths) < 0.25
    assert min(tenths) > 0
