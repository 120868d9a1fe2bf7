"""The bridge's decisions, with a network and connections in memory."""

from robotkube.robots.bridge.core.settings import GATEWAY_TYPE
from robotkube.robots.bridge.loops.flows import BATCH_BYTES_MAX
from robotkube.robots.mqtt.core.batches import decode_batch, encode_batch
from robotkube.robots.ros.core.common_messages import string_message, string_text
from tests.stages.bridge.in_memory import CLOUD, EVERYBODY, POSE, TRANSFORM, BridgeStage


def test_a_drain_becomes_one_batch() -> None:
    world = BridgeStage()
    world.configure(out=[POSE])
    world.connect()
    world.network.endpoint(POSE["name"]).waiting = [b"one", b"two"]
    world.bridge.turn(0.0)
    (sent,) = world.channels["telemetry"].sent
    assert (sent[0], sent[2]) == ("mqtt/vehicles/vehicle_00/pose", False)
    batch = decode_batch(sent[1])
    assert (batch.session, batch.sequence, batch.messages) == (42, 0, (b"one", b"two"))


def test_the_task_gateway_carries_texts_as_they_are() -> None:
    world = BridgeStage()
    status = {"name": "/robotkube/task_status", "type": GATEWAY_TYPE}
    world.configure(out=[{"name": "/robotkube/tasks", "type": GATEWAY_TYPE}], into=[status])
    world.connect()
    asked = [b'{"withdraw": "a"}', '{"ä": 1}'.encode()]
    cut_off = [b"\x00\x01", b"\x00\x01\0\0\xff\0\0\0x"]
    world.network.endpoint("/robotkube/tasks").waiting = [*map(string_message, asked), *cut_off]
    world.bridge.turn(0.0)
    telemetry = world.channels["telemetry"]
    assert telemetry.sent == [("robotkube/tasks/vehicle-00", text, False) for text in asked]
    assert 'robotkube_bridge_malformed_messages_total{topic="/robotkube/tasks"} 2' in world.bridge.metrics()
    assert "robotkube/task_status/vehicle-00" in telemetry.subscribed
    telemetry.events.received("robotkube/task_status/vehicle-00", b'{"id": "a"} \xff', b"")
    [published] = world.network.endpoint("/robotkube/task_status").published
    assert string_text(published) == b'{"id": "a"} ' + "\ufffd".encode()


def test_large_messages_get_batches_of_their_own() -> None:
    world = BridgeStage()
    world.configure(out=[CLOUD])
    world.connect()
    world.network.endpoint(CLOUD["name"]).waiting = [bytes(BATCH_BYTES_MAX // 2 + 1)] * 3
    world.bridge.turn(0.0)
    assert [decode_batch(payload).sequence for _, payload, _ in world.channels["bulk"].sent] == [0, 1, 2]


def test_messages_are_published_once() -> None:
    world = BridgeStage()
    world.configure(into=[POSE])
    world.connect()
    channel = world.channels["telemetry"]
    assert channel.subscribed == ["mqtt/vehicles/vehicle_00/pose"]
    for sequence in (0, 1, 1, 0, 2):
        channel.events.received("mqtt/vehicles/vehicle_00/pose", encode_batch(7, sequence, [b"%d" % sequence]), b"")
    assert world.network.endpoint(POSE["name"]).published == [b"0", b"1", b"2"]
    assert 'duplicate_batches_total{topic="/vehicles/vehicle_00/pose"} 2' in world.bridge.metrics()


def test_a_damaged_batch_is_counted_and_logged_once() -> None:
    world = BridgeStage()
    world.configure(into=[POSE])
    for _ in range(3):
        world.channels["telemetry"].events.received("mqtt/vehicles/vehicle_00/pose", b"nonsense", b"")
    assert 'refused_batches_total{channel="telemetry"} 3' in world.bridge.metrics()
    assert sum("batch refused" in line for line in world.lines) == 1


def test_new_settings_touch_only_what_differs() -> None:
    world = BridgeStage()
    world.configure(out=[POSE])
    world.connect()
    pose = world.network.endpoint(POSE["name"])
    world.configure(out=[POSE, CLOUD], into=[{**POSE, "name": "/other"}])
    assert world.network.endpoint(POSE["name"]) is pose
    assert world.channels["telemetry"].subscribed == ["mqtt/other"]
    world.configure(out=[POSE])
    assert [e.topic for e in world.network.made if e.closed] == [CLOUD["name"], "/other"]
    assert not pose.closed
    assert world.channels["telemetry"].unsubscribed == ["mqtt/other"]
    assert world.channels["bulk"].closed
    assert world.bridge.channels == ("telemetry",)


def test_sequences_go_on_when_a_topic_comes_back() -> None:
    world = BridgeStage()
    sequences = []
    for _ in range(2):
        world.configure(out=[POSE])
        world.connect()
        world.network.endpoint(POSE["name"]).waiting = [b"x"]
        world.bridge.turn(0.0)
        sequences.append(decode_batch(world.channels["telemetry"].sent[-1][1]).sequence)
        world.configure()
    assert sequences == [0, 1]


def test_an_unknown_type_is_not_carried_and_the_others_go_on() -> None:
    world = BridgeStage()
    world.configure(out=[{**CLOUD, "type": "nowhere/msg/Cloud"}, POSE])
    world.connect()
    assert "message package nowhere is not installed" in str(world.bridge.not_carried)
    assert "bridge_topics_refused 1\n" in world.bridge.metrics()
    assert world.bridge.complaint is None
    world.network.endpoint(POSE["name"]).waiting = [b"x"]
    world.bridge.turn(0.0)
    assert len(world.channels["telemetry"].sent) == 1
    world.configure(out=[POSE])
    assert world.bridge.not_carried == []


def test_ready_means_configured_and_connected() -> None:
    world = BridgeStage()
    assert world.bridge.complaint == "no settings yet"
    world.configure(out=[POSE])
    assert world.bridge.complaint == "not connected"
    world.connect()
    assert world.bridge.complaint is None
    world.channels["telemetry"].lose()
    assert world.bridge.complaint == "lost"


def test_a_refused_topic_leaves_the_bridge_ready_for_the_others() -> None:
    """It serves other applications, whose tasks would not be Ready with it."""
    world = BridgeStage()
    world.configure(into=[POSE, {**POSE, "name": "/other"}])
    world.connect()
    world.channels["telemetry"].events.refused("mqtt/other", "not authorised")
    assert world.bridge.not_carried == ["mqtt/other: not authorised"]
    assert world.bridge.complaint is None


def test_what_was_refused_of_a_topic_is_forgotten_when_it_is_closed() -> None:
    """Also what the broker answers after that: to messages under way, and to what takes back a retained one."""
    world = BridgeStage()
    world.configure(out=[TRANSFORM], into=[{**POSE, "name": "/other"}])
    world.connect()
    channel = world.channels["telemetry"]
    for number in (1, 2):
        world.network.endpoint(TRANSFORM["name"]).waiting = [b"x"]
        world.bridge.turn(float(number))
    channel.reject(1)
    channel.events.refused("mqtt/other", "not authorised")
    assert sorted(world.bridge.not_carried) == [
        "mqtt/other: not authorised",
        "mqtt/vehicles/vehicle_00/transform: not authorised",
    ]
    world.configure(out=[POSE])
    assert world.bridge.not_carried == []
    world.bridge.turn(3.0)
    assert channel.sent[-1][:2] == ("mqtt/vehicles/vehicle_00/transform", b"")
    for token in (2, 3):
        channel.reject(token)
    channel.events.refused("mqtt/other", "not authorised")
    assert world.bridge.not_carried == []
    assert world.bridge.complaint is None


def test_a_topic_that_comes_back_is_refused_anew() -> None:
    world = BridgeStage()
    world.configure(into=[POSE])
    world.connect()
    world.configure()
    world.configure(into=[POSE])
    world.channels["telemetry"].events.refused("mqtt/vehicles/vehicle_00/pose", "not authorised")
    assert world.bridge.not_carried == ["mqtt/vehicles/vehicle_00/pose: not authorised"]


def test_the_log_says_once_why_there_is_no_connection() -> None:
    world = BridgeStage()
    world.configure(out=[POSE])
    channel = world.channels["telemetry"]
    for complaint in (channel.complaint, "Not authorized", "Not authorized", None, "does not answer"):
        channel.complaint = complaint
        world.bridge.turn(0.0)
    assert world.logged("not connected") == [
        {"channel": "telemetry", "reason": "Not authorized"},
        {"channel": "telemetry", "reason": "does not answer"},
    ]


def test_retained_batches_are_sent_again_to_a_broker_that_forgot_them() -> None:
    world = BridgeStage()
    world.configure(out=[TRANSFORM])
    world.connect()
    channel = world.channels["telemetry"]
    world.network.endpoint(TRANSFORM["name"]).waiting = [b"x"]
    world.bridge.turn(0.0)
    channel.acknowledge(1)
    channel.lose()
    channel.connect(session_kept=True)
    world.bridge.turn(0.1)
    assert len(channel.sent) == 1
    channel.lose()
    channel.connect(session_kept=False)
    world.bridge.turn(0.2)
    assert channel.sent[0] == channel.sent[1]
    assert channel.sent[0][2]
    channel.acknowledge(2, heard=False)
    world.configure()
    world.bridge.turn(1e9)
    assert channel.sent[-1] == ("mqtt/vehicles/vehicle_00/transform", b"", True)


def test_topics_of_an_older_session_are_unsubscribed() -> None:
    world = BridgeStage()
    world.configure(into=[POSE])
    world.connect()
    world.channels["telemetry"].events.received("mqtt/long/gone", encode_batch(1, 1, [b"x"]), b"")
    assert {"mqtt/long/gone", "mqtt/+/gone"} <= set(world.channels["telemetry"].unsubscribed)


def test_what_is_subscribed_is_not_unsubscribed_for_a_message_that_is_for_nobody() -> None:
    world = BridgeStage()
    world.configure(into=[EVERYBODY])
    world.connect()
    world.channels["telemetry"].events.received("mqtt/vehicles/vehicle_00/pose", encode_batch(1, 1, [b"x"]), b"")
    world.channels["telemetry"].events.received("mqtt/other/vehicle_00/pose", encode_batch(1, 1, [b"x"]), b"")
    gone = world.channels["telemetry"].unsubscribed
    assert "mqtt/other/+/pose" in gone
    assert "mqtt/vehicles/+/pose" not in gone


def test_nothing_is_lost_over_a_reconnection() -> None:
    world = BridgeStage()
    world.configure(out=[POSE])
    world.connect()
    channel, pose = world.channels["telemetry"], world.network.endpoint(POSE["name"])
    pose.waiting = [b"0"]
    world.bridge.turn(0.0)
    channel.lose()
    pose.waiting = [b"1"]
    world.bridge.turn(0.1)
    channel.connect()
    for step in range(3):
        world.bridge.turn(0.2 + step)
        channel.acknowledge(len(channel.sent))
    assert [decode_batch(payload).messages[0] for _, payload, _ in channel.sent] == [b"0", b"0", b"1"]
