"""What a subscription counts and gives: losses by the numbers of publishers, and each message once when another
subscription takes its place."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from robotkube.robots.detector.adapters.ros_topics import BESIDE_SECONDS, KNOWN_SECONDS, RosInput
from robotkube.robots.ros.adapters.rclpy_node import MessageIdentity
from tests.stages.ros import self_receiver
from tests.stages.ros.renewing_receiver import COUNT
from tests.stages.waiting import until

pytestmark = pytest.mark.processes


class Numbered:
    """A subscription of the bindings: what waits are the numbers of messages."""

    matched = 1

    def __init__(self) -> None:
        self.waiting: list[int] = []
        self.closed = False

    def take_timed(self, messages_max: int) -> tuple[list[tuple[bytes, int]], int | None]:
        messages = self.take_sent(messages_max)
        return [(data, received) for data, received, _ in messages], messages[-1][2].number if messages else None

    def take_sent(self, messages_max: int) -> list[tuple[bytes, int, MessageIdentity]]:
        messages, self.waiting = self.waiting[:messages_max], self.waiting[messages_max:]
        return [(b"%d" % number, number, MessageIdentity(number, number)) for number in messages]

    def close(self) -> None:
        self.closed = True


class Stage:
    """One topic, its present subscription and the clock."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.now = 1 << 62
        self.subscription = Numbered()
        self.topic = self._make(None)

    def renew(self) -> Numbered:
        """Another subscription takes the place of the present one, which is given back."""
        before, self.subscription = self.subscription, Numbered()
        self.topic = self._make(self.topic)
        return before

    def _make(self, before: RosInput | None) -> RosInput:
        return RosInput(cast(Any, self.subscription), lambda: self.seconds, lambda: self.now, before)

    def drain(self, *numbers: int) -> list[int]:
        self.subscription.waiting += numbers
        return [int(data) for data, _ in self.topic.drain(100)]

    def lost_after(self, *numbers: int) -> int:
        self.drain(*numbers)
        return self.topic.lost


@pytest.fixture(params=[0.0, 10.0], ids=["new", "old"])
def stage(request: pytest.FixtureRequest) -> Stage:
    """A subscription of this age."""
    stage = Stage()
    stage.drain(69)
    stage.seconds = request.param
    stage.drain()
    return stage


def test_a_gap_in_the_numbers_of_one_publisher_is_what_was_lost(stage: Stage) -> None:
    assert stage.lost_after(70, 71) == 0, "what it said before anybody listened is not lost"
    assert stage.lost_after(72, 73) == 0
    assert stage.lost_after(80, 81) == 6
    assert stage.lost_after(1, 2) == 6, "it began anew"
    assert stage.lost_after(4) == 7


def test_several_publishers_number_their_own_messages(stage: Stage) -> None:
    stage.lost_after(500)
    lost = stage.topic.lost
    stage.subscription.matched = 2
    for step in range(10):
        one, other = 600 + step, step + 1
        assert stage.lost_after(*((other, one) if step % 2 else (one, other))) == lost
    stage.subscription.matched = 1
    assert stage.lost_after(900) == lost, "the other one went; only from here on there is one"
    assert stage.lost_after(903) == lost + 2


def test_who_takes_the_place_of_another_gives_each_message_once(stage: Stage) -> None:
    """Publishers hear of the new one late, and keep what they said."""
    assert stage.drain(70, 71) == [70, 71]
    before = stage.renew()
    before.waiting += [72, 73]
    assert stage.drain() == [72, 73], "nobody has heard of the new one yet"
    before.waiting += [74, 75]
    assert stage.drain(60, 72, 75, 76) == [60, 74, 75, 76], "in the order of reception"
    before.waiting += [76, 79]
    assert stage.drain(77) == [77, 79]
    assert (before.closed, stage.topic.lost) == (False, 2), "the one before counts while it is there"
    stage.seconds += BESIDE_SECONDS + 0.1
    before.waiting.append(80)
    assert stage.drain() == [80]
    assert before.closed
    assert stage.drain(80, 81) == [81], "it was on its way here, too"
    stage.seconds += KNOWN_SECONDS
    assert stage.drain(82) == [82]
    assert stage.drain(85) == [85]
    assert stage.topic.lost == 4


def test_what_was_said_before_another_took_its_place_comes_once() -> None:
    """A publisher that keeps what it said tells the new one all of it; most often its first messages made it so."""
    stage = Stage()
    assert stage.drain(5, 6) == [5, 6]
    stage.seconds += 1
    stage.renew()
    assert stage.drain(1, 2, 3, 4, 5, 6, 7) == [1, 2, 3, 4, 7]


def test_what_was_said_before_comes_once_also_when_publishers_hear_of_the_new_one_late() -> None:
    stage = Stage()
    stage.drain(5, 6)
    stage.seconds += 1
    before = stage.renew()
    before.waiting += [7]
    assert stage.drain() == [7]
    stage.seconds += BESIDE_SECONDS + KNOWN_SECONDS + 1
    assert stage.drain() == []
    assert before.closed
    assert stage.drain(4, 5, 6, 7, 8) == [4, 8]


def test_one_after_the_other_take_their_places_and_all_are_closed() -> None:
    stage = Stage()
    stage.drain(1)
    first = stage.renew()
    second = stage.renew()
    first.waiting, second.waiting = [2, 3, 4], [3, 4, 5]
    assert stage.drain(5, 6) == [2, 3, 4, 5, 6]
    stage.topic.close()
    assert (first.closed, second.closed, stage.subscription.closed) == (True, True, True)


def test_what_comes_while_two_are_drained_is_not_ahead_of_what_only_the_other_one_got() -> None:
    """A publisher that has not heard of the new one yet, and one that only the new one hears."""
    stage = Stage()
    stage.drain(70)
    before = stage.renew()
    stage.now = 75
    before.waiting += [74]
    assert stage.drain(73, 77, 79) == [73, 74], "76 and 78 are on their way to the one before"
    stage.now = 78
    before.waiting += [76, 78]
    assert stage.drain() == [76, 77, 78]
    stage.now = 79
    assert stage.drain(80) == [79]
    third = stage.renew()
    assert third.waiting == []
    assert stage.drain(81) == []
    stage.seconds += BESIDE_SECONDS + 0.1
    stage.now = 81
    assert stage.drain(82) == [80, 81], "none is lost with the subscription that it came from"
    stage.seconds += KNOWN_SECONDS
    assert stage.drain(83) == [82, 83]


def test_a_real_publisher_is_heard_once_and_without_a_gap(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    receiver = start("-m", "tests.stages.ros.renewing_receiver", "/numbers", str(tmp_path / "numbers.json"))
    wanted = {"durability": "transient_local", "period": 0.002, "count": COUNT}
    start("-m", "tests.stages.ros.qos_publisher", "/numbers", json.dumps(wanted))
    until(lambda: receiver.poll() is not None)
    assert receiver.returncode == 0
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    assert sorted(numbers) == list(range(-1, COUNT - 1))


def test_a_subscription_gives_what_waits_in_three_forms(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    process = start("-m", "tests.stages.ros.self_receiver", "/bytes", str(tmp_path / "results.json"))
    until(lambda: process.poll() is not None)
    assert process.returncode == 0
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["empty"] == [[], [[], None], []]

    numbers = list(range(self_receiver.COUNT + 1))
    sizes = [
        len(self_receiver.message(number, self_receiver.LONG_BYTES * (number == self_receiver.COUNT)))
        for number in numbers
    ]
    assert max(map(len, results["take"])) <= 3
    assert [tuple(one) for several in results["take"] for one in several] == list(zip(numbers, sizes, strict=True))

    assert max(len(several) for several, _ in results["take_timed"]) <= 4
    assert [number for several, _ in results["take_timed"] for number, _ in several] == numbers
    for several, last in results["take_timed"]:
        assert last == (several[-1][0] + 1 if several else None), "a publisher numbers from 1"

    assert [(number, position) for number, _, _, position in results["take_sent"]] == [
        (one, one + 1) for one in numbers
    ]
    for _, received, sent, _ in results["take_sent"]:
        assert results["began"] <= sent <= received <= results["ended"]

    assert results["closed"] == ["the subscription is closed"] * 3
    first, last = results["memory"]
    assert last - first < 4 * self_receiver.BURST_BYTES, "a tenth of what went through, and what allocators keep"
