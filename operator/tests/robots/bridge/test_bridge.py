"""The bridge's decisions, with a network and connections in memory."""

from robotkube.robots.bridge.core.settings import GATEWAY_TYPE
from robotkube.robots.bridge.loops.flows import BATCH_BYTES_MAX
from robotkube.robots.mqtt.core.batches import decode_batch, encode_batch
from robotkube.robots.ros.core.common_messages import string_message, string_text
from tests.stages.bridge.in_memory import CLOUD, EVERYBODY, POSE, TRANSFORM, BridgeStage


def test_a_drain_becomes_one_batch() -> None:
    stage = BridgeStage()
    stage.configure(out=[POSE])
    stage.connect()
    stage.network.endpoint(POSE["name"]).waiting = [b"one", b"two"]
    stage.bridge.turn(0.0)
    (sent,) = stage.channels["telemetry"].sent
    assert (sent[0], sent[2]) == ("mqtt/vehicles/vehicle_00/pose", False)
    batch = decode_batch(sent[1])
    assert (batch.session, batch.sequence, batch.messages) == (42, 0, (b"one", b"two"))


def test_the_task_gateway_carries_texts_as_they_are() -> None:
    stage = BridgeStage()
    status = {"name": "/robotkube/task_status", "type": GATEWAY_TYPE}
    stage.configure(out=[{"name": "/robotkube/tasks", "type": GATEWAY_TYPE}], into=[status])
    stage.connect()
    asked = [b'{"withdraw": "a"}', '{"ä": 1}'.encode()]
    cut_off = [b"\x00\x01", b"\x00\x01\0\0\xff\0\0\0x"]
    stage.network.endpoint("/robotkube/tasks").waiting = [*map(string_message, asked), *cut_off]
    stage.bridge.turn(0.0)
    telemetry = stage.channels["telemetry"]
    assert telemetry.sent == [("robotkube/tasks/vehicle-00", text, False) for text in asked]
    assert 'robotkube_bridge_malformed_messages_total{topic="/robotkube/tasks"} 2' in stage.bridge.metrics()
    assert "robotkube/task_status/vehicle-00" in telemetry.subscribed
    telemetry.events.received("robotkube/task_status/vehicle-00", b'{"id": "a"} \xff', b"")
    [published] = stage.network.endpoint("/robotkube/task_status").published
    assert string_text(published) == b'{"id": "a"} ' + "\ufffd".encode()


def test_large_messages_get_batches_of_their_own() -> None:
    stage = BridgeStage()
    stage.configure(out=[CLOUD])
    stage.connect()
    stage.network.endpoint(CLOUD["name"]).waiting = [bytes(BATCH_BYTES_MAX // 2 + 1)] * 3
    stage.bridge.turn(0.0)
    assert [decode_batch(payload).sequence for _, payload, _ in stage.channels["bulk"].sent] == [0, 1, 2]


def test_messages_are_published_once() -> None:
    stage = BridgeStage()
    stage.configure(into=[POSE])
    stage.connect()
    channel = stage.channels["telemetry"]
    assert channel.subscribed == ["mqtt/vehicles/vehicle_00/pose"]
    for sequence in (0, 1, 1, 0, 2):
        channel.events.received("mqtt/vehicles/vehicle_00/pose", encode_batch(7, sequence, [b"%d" % sequence]), b"")
    assert stage.network.endpoint(POSE["name"]).published == [b"0", b"1", b"2"]
    assert 'duplicate_batches_total{topic="/vehicles/vehicle_00/pose"} 2' in stage.bridge.metrics()


def test_a_damaged_batch_is_counted_and_logged_once() -> None:
    stage = BridgeStage()
    stage.configure(into=[POSE])
    for _ in range(3):
        stage.channels["telemetry"].events.received("mqtt/vehicles/vehicle_00/pose", b"nonsense", b"")
    assert 'refused_batches_total{channel="telemetry"} 3' in stage.bridge.metrics()
    assert sum("batch refused" in line for line in stage.lines) == 1


def test_new_settings_touch_only_what_differs() -> None:
    stage = BridgeStage()
    stage.configure(out=[POSE])
    stage.connect()
    pose = stage.network.endpoint(POSE["name"])
    stage.configure(out=[POSE, CLOUD], into=[{**POSE, "name": "/other"}])
    assert stage.network.endpoint(POSE["name"]) is pose
    assert stage.channels["telemetry"].subscribed == ["mqtt/other"]
    stage.configure(out=[POSE])
    assert [e.topic for e in stage.network.made if e.closed] == [CLOUD["name"], "/other"]
    assert not pose.closed
    assert stage.channels["telemetry"].unsubscribed == ["mqtt/other"]
    assert stage.channels["bulk"].closed
    assert stage.bridge.channels == ("telemetry",)


def test_sequences_go_on_when_a_topic_comes_back() -> None:
    stage = BridgeStage()
    sequences = []
    for _ in range(2):
        stage.configure(out=[POSE])
        stage.connect()
        stage.network.endpoint(POSE["name"]).waiting = [b"x"]
        stage.bridge.turn(0.0)
        sequences.append(decode_batch(stage.channels["telemetry"].sent[-1][1]).sequence)
        stage.configure()
    assert sequences == [0, 1]


def test_an_unknown_type_is_not_carried_and_the_others_go_on() -> None:
    stage = BridgeStage()
    stage.configure(out=[{**CLOUD, "type": "nowhere/msg/Cloud"}, POSE])
    stage.connect()
    assert "message package nowhere is not installed" in str(stage.bridge.not_carried)
    assert "bridge_topics_refused 1\n" in stage.bridge.metrics()
    assert stage.bridge.complaint is None
    stage.network.endpoint(POSE["name"]).waiting = [b"x"]
    stage.bridge.turn(0.0)
    assert len(stage.channels["telemetry"].sent) == 1
    stage.configure(out=[POSE])
    assert stage.bridge.not_carried == []


def test_ready_means_configured_and_connected() -> None:
    stage = BridgeStage()
    assert stage.bridge.complaint == "no settings yet"
    stage.configure(out=[POSE])
    assert stage.bridge.complaint == "not connected"
    stage.connect()
    assert stage.bridge.complaint is None
    stage.channels["telemetry"].lose()
    assert stage.bridge.complaint == "lost"


def test_a_refused_topic_leaves_the_bridge_ready_for_the_others() -> None:
    """It serves other applications, whose tasks would not be Ready with it."""
    stage = BridgeStage()
    stage.configure(into=[POSE, {**POSE, "name": "/other"}])
    stage.connect()
    stage.channels["telemetry"].events.refused("mqtt/other", "not authorised")
    assert stage.bridge.not_carried == ["mqtt/other: not authorised"]
    assert stage.bridge.complaint is None


def test_what_was_refused_of_a_topic_is_forgotten_when_it_is_closed() -> None:
    """Also what the broker answers after that: to messages under way, and to what takes back a retained one."""
    stage = BridgeStage()
    stage.configure(out=[TRANSFORM], into=[{**POSE, "name": "/other"}])
    stage.connect()
    channel = stage.channels["telemetry"]
    for number in (1, 2):
        stage.network.endpoint(TRANSFORM["name"]).waiting = [b"x"]
        stage.bridge.turn(float(number))
    channel.reject(1)
    channel.events.refused("mqtt/other", "not authorised")
    assert sorted(stage.bridge.not_carried) == [
        "mqtt/other: not authorised",
        "mqtt/vehicles/vehicle_00/transform: not authorised",
    ]
    stage.configure(out=[POSE])
    assert stage.bridge.not_carried == []
    stage.bridge.turn(3.0)
    assert channel.sent[-1][:2] == ("mqtt/vehicles/vehicle_00/transform", b"")
    for token in (2, 3):
        channel.reject(token)
    channel.events.refused("mqtt/other", "not authorised")
    assert stage.bridge.not_carried == []
    assert stage.bridge.complaint is None


def test_a_topic_that_comes_back_is_refused_anew() -> None:
    stage = BridgeStage()
    stage.configure(into=[POSE])
    stage.connect()
    stage.configure()
    stage.configure(into=[POSE])
    stage.channels["telemetry"].events.refused("mqtt/vehicles/vehicle_00/pose", "not authorised")
    assert stage.bridge.not_carried == ["mqtt/vehicles/vehicle_00/pose: not authorised"]


def test_the_log_says_once_why_there_is_no_connection() -> None:
    stage = BridgeStage()
    stage.configure(out=[POSE])
    channel = stage.channels["telemetry"]
    for complaint in (channel.complaint, "Not authorized", "Not authorized", None, "does not answer"):
        channel.complaint = complaint
        stage.bridge.turn(0.0)
    assert stage.logged("not connected") == [
        {"channel": "telemetry", "reason": "Not authorized"},
        {"channel": "telemetry", "reason": "does not answer"},
    ]


def test_retained_batches_are_sent_again_to_a_broker_that_forgot_them() -> None:
    stage = BridgeStage()
    stage.configure(out=[TRANSFORM])
    stage.connect()
    channel = stage.channels["telemetry"]
    stage.network.endpoint(TRANSFORM["name"]).waiting = [b"x"]
    stage.bridge.turn(0.0)
    channel.acknowledge(1)
    channel.lose()
    channel.connect(session_kept=True)
    stage.bridge.turn(0.1)
    assert len(channel.sent) == 1
    channel.lose()
    channel.connect(session_kept=False)
    stage.bridge.turn(0.2)
    assert channel.sent[0] == channel.sent[1]
    assert channel.sent[0][2]
    channel.acknowledge(2, heard=False)
    stage.configure()
    stage.bridge.turn(1e9)
    assert channel.sent[-1] == ("mqtt/vehicles/vehicle_00/transform", b"", True)


def test_topics_of_an_older_session_are_unsubscribed() -> None:
    stage = BridgeStage()
    stage.configure(into=[POSE])
    stage.connect()
    stage.channels["telemetry"].events.received("mqtt/long/gone", encode_batch(1, 1, [b"x"]), b"")
    assert {"mqtt/long/gone", "mqtt/+/gone"} <= set(stage.channels["telemetry"].unsubscribed)


def test_what_is_subscribed_is_not_unsubscribed_for_a_message_that_is_for_nobody() -> None:
    stage = BridgeStage()
    stage.configure(into=[EVERYBODY])
    stage.connect()
    stage.channels["telemetry"].events.received("mqtt/vehicles/vehicle_00/pose", encode_batch(1, 1, [b"x"]), b"")
    stage.channels["telemetry"].events.received("mqtt/other/vehicle_00/pose", encode_batch(1, 1, [b"x"]), b"")
    gone = stage.channels["telemetry"].unsubscribed
    assert "mqtt/other/+/pose" in gone
    assert "mqtt/vehicles/+/pose" not in gone


def test_nothing_is_lost_over_a_reconnection() -> None:
    stage = BridgeStage()
    stage.configure(out=[POSE])
    stage.connect()
    channel = stage.channels["telemetry"]
    pose = stage.network.endpoint(POSE["name"])
    pose.waiting = [b"0"]
    stage.bridge.turn(0.0)
    channel.lose()
    pose.waiting = [b"1"]
    stage.bridge.turn(0.1)
    channel.connect()
    for step in range(3):
        stage.bridge.turn(0.2 + step)
        channel.acknowledge(len(channel.sent))
    assert [decode_batch(payload).messages[0] for _, payload, _ in channel.sent] == [b"0", b"0", b"1"]
