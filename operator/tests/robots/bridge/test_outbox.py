"""The outbox: order, bounds, what happens around a reconnection."""

from hypothesis import given
from hypothesis import strategies as st

from robotkube.robots.bridge.core.outbox import (
    SETTLING_RETRY_SECONDS,
    SETTLING_SECONDS,
    Outbox,
    OutboxBounds,
)
from robotkube.robots.bridge.core.waiting_batches import OutgoingBatch

BOUNDS = OutboxBounds(seconds_max=60, batches_max=5, bytes_max=1000, inflight_max=2)


def make(bounds: OutboxBounds = BOUNDS) -> Outbox:
    return Outbox(bounds)


def batch(number: int, born: float = 0.0, retained: bool = False) -> OutgoingBatch:
    return OutgoingBatch("topic", b"%d" % number, 1, retained, born)


def send(outbox: Outbox, token: int, now: float = 0.0) -> bytes | None:
    following = outbox.next(now)
    if following is not None:
        outbox.sent(token, following)
    return None if following is None else following.payload


def test_batches_leave_in_order_within_the_window() -> None:
    outbox = make()
    outbox.connected(0)
    for number in range(3):
        outbox.put(batch(number))
    assert [send(outbox, 1), send(outbox, 2), send(outbox, 3)] == [b"0", b"1", None]
    outbox.acknowledged(1, True, 0)
    assert send(outbox, 3) == b"2"
    outbox.acknowledged(2, True, 0)
    outbox.acknowledged(3, True, 0)
    assert len(outbox) == 0


def test_the_oldest_go_and_are_counted() -> None:
    outbox = make()
    for number in range(8):
        outbox.put(batch(number))
    assert (outbox.dropped, len(outbox)) == (3, 5)
    outbox.put(batch(8, born=61))
    assert (outbox.dropped, len(outbox)) == (8, 1)


def test_unacknowledged_batches_are_sent_again_first() -> None:
    outbox = make()
    outbox.connected(0)
    for number in range(4):
        outbox.put(batch(number))
    assert [send(outbox, 1), send(outbox, 2)] == [b"0", b"1"]
    outbox.disconnected(1)
    outbox.connected(2)
    assert [f.payload for f in outbox.waiting] == [b"0", b"1", b"2", b"3"]


def test_after_a_reconnection_unheard_batches_are_tried_again_one_at_a_time() -> None:
    outbox = make()
    outbox.connected(0)
    outbox.put(batch(0))
    outbox.put(batch(1))
    outbox.connected(10)
    assert [send(outbox, 1, 10), send(outbox, 2, 10)] == [b"0", None]
    outbox.acknowledged(1, False, 10)
    assert send(outbox, 2, 10) is None
    later = 10 + SETTLING_RETRY_SECONDS
    assert send(outbox, 2, later) == b"0"
    outbox.acknowledged(2, True, later)
    assert send(outbox, 3, later) == b"1"


def test_nobody_listening_ends_the_settling() -> None:
    outbox = make()
    outbox.connected(0)
    outbox.connected(10)
    outbox.put(batch(0, 10))
    assert send(outbox, 1, 10) == b"0"
    outbox.acknowledged(1, False, 10 + SETTLING_SECONDS)
    assert len(outbox) == 0


def test_the_first_connection_does_not_wait_for_listeners() -> None:
    outbox = make()
    outbox.connected(0)
    outbox.put(batch(0))
    assert send(outbox, 1) == b"0"
    outbox.acknowledged(1, False, 0)
    assert len(outbox) == 0


def test_retained_batches_need_no_listener() -> None:
    outbox = make()
    outbox.connected(0)
    outbox.connected(1)
    outbox.put(batch(0, 1, retained=True))
    assert send(outbox, 1, 1) == b"0"
    outbox.acknowledged(1, False, 1)
    assert len(outbox) == 0


def test_a_topic_that_is_not_carried_any_more_is_forgotten() -> None:
    outbox = make()
    outbox.put(batch(0))
    outbox.put(OutgoingBatch("other", b"1", 1))
    outbox.forget("topic")
    assert [f.topic for f in outbox.waiting] == ["other"]


@given(st.lists(st.sampled_from(["put", "send", "acknowledge", "reconnect"]), max_size=60))
def test_what_arrives_first_arrives_in_order(actions: list[str]) -> None:
    """Whatever happens, a receiver that drops what it has seen gets ascending numbers."""
    outbox = make(OutboxBounds(60, 10, 1000, 3))
    outbox.connected(0)
    number = 0
    token = 0
    flying = []
    arrived = []
    for action in actions:
        if action == "put":
            outbox.put(batch(number))
            number += 1
        elif action == "send" and (following := outbox.next(0)) is not None:
            token += 1
            outbox.sent(token, following)
            flying.append(token)
            if int(following.payload) not in arrived:
                arrived.append(int(following.payload))
        elif action == "acknowledge" and flying:
            outbox.acknowledged(flying.pop(0), True, 0)
        elif action == "reconnect":
            flying.clear()
            outbox.connected(0)
    assert arrived == sorted(arrived)
