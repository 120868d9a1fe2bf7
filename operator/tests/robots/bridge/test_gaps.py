"""What a bridge drops: counted by topic, place and reason with first and last stamp, and reported to the receiver."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from benchmarks.measuring.bags import message
from robotkube.robots.bridge.core.losses import OTHERS, TOPICS_MAX, Losses
from robotkube.robots.bridge.core.outbox import LARGE, MANY, OLD, REFUSED, Outbox, OutboxBounds
from robotkube.robots.bridge.core.waiting_batches import OutgoingBatch
from robotkube.robots.mqtt.core.batches import encode_batch
from robotkube.robots.mqtt.core.message_properties import (
    GAPS_PER_MESSAGE_MAX,
    GAPS_TOPIC,
    gaps_property,
    read_gap_text,
    read_gaps,
)
from robotkube.robots.mqtt.core.properties import read_properties
from robotkube.robots.ros.core.common_messages import string_text
from robotkube.robots.ros.core.gaps import Gap
from tests.stages.bridge.in_memory import CLOUD, POSE, BridgeStage

WHERE = "mqtt-bridge of vehicle-00"


def gaps_sent(stage: BridgeStage, channel: str, place: int = -1) -> list[Gap]:
    user = read_properties(stage.channels[channel].properties[place]).user
    return read_gaps(user["gaps"]) if "gaps" in user else []


def after_an_outage(stage: BridgeStage) -> None:
    """20 s without a broker: of 200 clouds the last ten are kept."""
    stage.configure(out=[CLOUD])
    stage.connect()
    stage.channels["bulk"].lose()
    for number in range(200):
        stage.network.endpoint(CLOUD["name"]).waiting = [message(number, number, 800_000)]
        stage.bridge.turn(number / 10)
    stage.channels["bulk"].connect()
    stage.bridge.turn(19.95)


def test_clouds_of_an_outage_are_reported_with_the_first_one_after_it() -> None:
    stage = BridgeStage()
    after_an_outage(stage)
    assert gaps_sent(stage, "bulk") == [Gap(CLOUD["name"], WHERE, MANY, 190, 0, 189)]
    assert stage.logged("messages dropped") == []
    stage.channels["bulk"].acknowledge(1)
    gap = {"why": MANY, "where": WHERE, "count": 190, "first": 0, "last": 189, "topic": CLOUD["name"]}
    assert stage.logged("messages dropped") == [{"channel": "bulk", **gap}]
    stage.bridge.turn(19.96)
    assert len(stage.channels["bulk"].sent) == 5, "then as many as may be on their way at once"
    assert gaps_sent(stage, "bulk") == []
    labels = f'{{channel="bulk",topic="{CLOUD["name"]}",where="{WHERE}",why="{MANY}"}}'
    assert f"robotkube_bridge_dropped_messages_total{labels} 190" in stage.bridge.metrics()
    assert f"robotkube_bridge_dropped_last_stamp_seconds{labels} 0.000000189" in stage.bridge.metrics()


def test_a_gap_whose_batch_is_dropped_is_reported_by_the_next_one() -> None:
    stage = BridgeStage()
    after_an_outage(stage)
    stage.channels["bulk"].lose()
    stage.network.endpoint(CLOUD["name"]).waiting = [message(200, 200, 800_000)]
    stage.bridge.turn(20.0)
    stage.channels["bulk"].connect()
    stage.bridge.turn(20.1)
    assert gaps_sent(stage, "bulk") == [Gap(CLOUD["name"], WHERE, MANY, 191, 0, 190)]


def test_what_nobody_could_receive_is_reported_at_the_end() -> None:
    stage = BridgeStage()
    after_an_outage(stage)
    stage.bridge.close()
    assert [fields["count"] for fields in stage.logged("messages dropped")] == [190]


def test_a_batch_that_the_broker_refuses_is_a_gap_and_named() -> None:
    stage = BridgeStage()
    stage.configure(out=[POSE])
    stage.connect()
    for number in range(2):
        stage.network.endpoint(POSE["name"]).waiting = [message(number, 7 + number, 76)]
        stage.bridge.turn(float(number))
        stage.channels["telemetry"].reject(1)
    assert gaps_sent(stage, "telemetry") == [Gap(POSE["name"], WHERE, REFUSED, 1, 7, 7)]
    assert "mqtt/vehicles/vehicle_00/pose: not authorised" in str(stage.bridge.not_carried)


def test_the_receiver_publishes_reported_gaps() -> None:
    stage = BridgeStage()
    stage.configure(into=[POSE], publish_gaps=True)
    stage.connect()
    gap = Gap(POSE["name"], WHERE, OLD, 3, 10, 30)
    batch = encode_batch(1, 4, [b"pose"])
    for _ in range(2):
        stage.channels["telemetry"].events.received("mqtt" + POSE["name"], batch, gaps_property([gap]))
    assert [read_gap_text(string_text(one).decode()) for one in stage.network.endpoint(GAPS_TOPIC).published] == [gap]
    assert len(stage.logged("messages missing")) == 1
    stage.configure(into=[POSE])
    assert [e.topic for e in stage.network.made if e.closed] == [GAPS_TOPIC]


def test_a_batch_of_another_type_or_with_broken_properties_is_refused() -> None:
    stage = BridgeStage()
    stage.configure(into=[POSE])
    stage.connect()
    batch = encode_batch(1, 0, [b"pose"])
    wrong_type = b"\x26\0\x04type\0\x01x"
    for properties in (wrong_type, b"\x26", b"\x26\0\x04gaps\0\x01{"):
        stage.channels["telemetry"].events.received("mqtt" + POSE["name"], batch, properties)
    assert stage.network.endpoint(POSE["name"]).published == []
    assert 'refused_batches_total{channel="telemetry"} 3' in stage.bridge.metrics()
    assert "its type is x, that of the topic geometry_msgs/msg/PoseStamped" in str(stage.logged("batch refused"))


def batch(number: int, born: float, retained: bool = False, size: int = 1) -> OutgoingBatch:
    return OutgoingBatch("t", bytes(size), 1, retained, born, b"", "/t", number, number)


def test_each_bound_has_its_reason_and_retained_batches_stay() -> None:
    outbox = Outbox(OutboxBounds(seconds_max=60, batches_max=5, bytes_max=100, inflight_max=2))
    outbox.put(batch(0, 0, retained=True))
    outbox.put(batch(1, 0))
    outbox.put(batch(2, 50))
    following = outbox.next(70)
    assert following is not None
    assert (following.retained, [gap.first for gap in following.gaps]) == (True, [1])
    assert [(gap.why, gap.first, gap.last) for gap in outbox.losses.sums] == [(OLD, 1, 1)]
    outbox.put(batch(3, 70, size=100))
    assert [(gap.why, gap.first) for gap in outbox.losses.sums] == [(OLD, 1), (LARGE, 2)]
    for number in range(4, 10):
        outbox.put(batch(number, 71))
    assert [(gap.why, gap.first, gap.last) for gap in outbox.losses.sums] == [(OLD, 1, 1), (LARGE, 2, 3), (MANY, 4, 4)]
    assert outbox.bytes == 5


def test_what_does_not_fit_beside_a_message_is_reported_with_the_next() -> None:
    outbox = Outbox(OutboxBounds(seconds_max=60, batches_max=5, bytes_max=100, inflight_max=2))
    reasons = [f"reason {number}" for number in range(GAPS_PER_MESSAGE_MAX + 2)]
    for number, why in enumerate(reasons):
        outbox.losses.add(Gap("/t", "here", why, 1, number, number))
    reported = []
    for number in range(2):
        outbox.put(batch(number, 0))
        following = outbox.next(0)
        assert following is not None
        outbox.sent(number, following)
        reported.append([gap.why for gap in following.gaps])
        assert read_gaps(read_properties(gaps_property(following.gaps)).user["gaps"]) == list(following.gaps)
    assert reported == [reasons[:GAPS_PER_MESSAGE_MAX], reasons[GAPS_PER_MESSAGE_MAX:]]
    assert outbox.unreported == [Gap("/t", "here", why, 1, number, number) for number, why in enumerate(reasons)]


def test_losses_are_bounded() -> None:
    losses = Losses()
    for number in range(TOPICS_MAX + 5):
        losses.add(Gap(f"/t{number}", "w", "y", 1, number, number))
    assert len(list(losses.sums)) == TOPICS_MAX + 1
    assert [gap.count for gap in losses.sums if gap.topic == OTHERS] == [5]


@given(st.lists(st.sampled_from(["put", "send", "acknowledge", "reject", "lose", "wait"]), max_size=80))
def test_every_message_is_delivered_or_in_a_gap(actions: list[str]) -> None:
    """Whatever happens, the numbers that were not delivered are those that the sums count and the gaps cover."""
    outbox = Outbox(OutboxBounds(seconds_max=5, batches_max=4, bytes_max=1000, inflight_max=2))
    outbox.connected(0)
    number = token = 0
    now = 0.0
    flying: dict[int, OutgoingBatch] = {}
    delivered: set[int] = set()
    reported: list[Gap] = []
    for action in actions:
        if action == "put":
            outbox.put(batch(number, now))
            number += 1
        elif action == "send" and (following := outbox.next(now)) is not None:
            token += 1
            outbox.sent(token, following)
            flying[token] = following
        elif action in ("acknowledge", "reject") and flying:
            first = min(flying)
            following = flying.pop(first)
            if action == "acknowledge":
                delivered.add(following.first)
                reported += outbox.acknowledged(first, True, now)
            else:
                outbox.rejected(first)
        elif action == "lose":
            flying.clear()
            outbox.connected(now)
        elif action == "wait":
            now += 3
    kept = {one.first for one in (*flying.values(), *outbox.waiting)}
    missing = set(range(number)) - delivered - kept
    gaps = [*reported, *outbox.unreported]
    assert sum(gap.count or 0 for gap in outbox.losses.sums) == outbox.dropped == len(missing)
    assert sum(gap.count or 0 for gap in gaps) == len(missing)
    assert all(any(gap.covers(stamp) for gap in gaps) for stamp in missing)
