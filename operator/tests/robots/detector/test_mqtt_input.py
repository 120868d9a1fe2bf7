"""Topics that come by MQTT and messages that go there, over a connection in memory."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from robotkube.robots.detector.adapters.type_definitions import definition
from robotkube.robots.detector.core.settings import MQTT, TopicSettings
from robotkube.robots.detector.loops.broker import QUEUE_MAX, TOPICS_MAX, Broker, MqttReactions
from robotkube.robots.mqtt.core.batches import encode_batch
from robotkube.robots.mqtt.core.message_properties import gaps_property, type_properties
from robotkube.robots.mqtt.core.properties import read_properties
from robotkube.robots.mqtt.ports import ChannelEvents
from robotkube.robots.reactions.core.settings import MqttReactionSettings
from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
from robotkube.robots.reactions.ports.deliveries import EdgeDelivery
from robotkube.robots.ros.core.gaps import Gap
from robotkube.robots.ros.core.qos import QosProfile
from robotkube.robots.ros.core.topic_patterns import TopicPattern
from robotkube.robots.rules.core import START

TYPE = "geometry_msgs/msg/PoseStamped"
POSES = TopicSettings(TopicPattern("/vehicles/{agent}/pose"), TYPE, MQTT, depth=5)
POSE = "mqtt/vehicles/vehicle_00/pose"
NAME = "/vehicles/vehicle_00/pose"


class Channel:
    """Port FrameChannel, in memory."""

    def __init__(self) -> None:
        self.complaint: str | None = "not connected"
        self.filters: set[str] = set()
        self.published: list[tuple[str, bytes, bool, bytes]] = []
        self.closed = False

    def turn(self, now: float) -> None: ...

    def publish(self, topic: str, payload: bytes, retained: bool, properties: bytes = b"") -> int | None:
        if self.complaint is not None:
            return None
        self.published.append((topic, payload, retained, properties))
        return len(self.published)

    def subscribe(self, topics: Sequence[str]) -> None:
        self.filters |= set(topics)

    def unsubscribe(self, topics: Sequence[str]) -> None:
        self.filters -= set(topics)

    def flush(self) -> None: ...

    def close(self) -> None:
        self.closed = True


class Stage:
    def __init__(self) -> None:
        self.channel = Channel()
        self.learned = list[str]()
        self.seconds = 0.0
        self.gaps: list[Gap] = []
        self.broker = Broker(self._make, lambda: 1_000, lambda: self.seconds, self.learned.append, self.gaps.append)

    def _make(self, events: ChannelEvents) -> Channel:
        return self.channel

    def connect(self) -> None:
        self.channel.complaint = None
        self.broker.connected(False)

    def frame(self, sequence: int, *messages: bytes, topic: str = POSE, type_name: str = TYPE) -> None:
        self.broker.received(topic, encode_batch(1, sequence, messages), type_properties(type_name, ""))


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_topics_of_any_agent_are_found_by_what_comes(stage: Stage) -> None:
    stage.broker.announce([POSES])
    stage.connect()
    assert stage.channel.filters == {"mqtt/vehicles/+/pose", "robotkube/types/mqtt/vehicles/+/pose"}
    assert stage.broker.visible() == {}
    stage.frame(0, b"a", b"b")
    stage.frame(1, b"c")
    stage.frame(1, b"c")
    assert stage.broker.visible() == {NAME: (TYPE,)}
    topic = stage.broker.subscribe(NAME, POSES, QosProfile())
    assert topic.drain(2) == [(b"a", 1_000), (b"b", 1_000)], "what came before somebody subscribed is there"
    assert topic.drain(500) == [(b"c", 1_000)], "a frame that came twice counts once"
    assert topic.drain(500) == ()


def test_the_oldest_go_when_nobody_drains(stage: Stage) -> None:
    stage.broker.announce([POSES])
    topic = stage.broker.subscribe(NAME, POSES, QosProfile())
    stage.frame(0, *(b"%d" % number for number in range(8)))
    assert [data for data, _ in topic.drain(500)] == [b"3", b"4", b"5", b"6", b"7"]
    assert topic.lost == 3


def test_what_is_no_frame_or_of_another_type_is_counted(stage: Stage) -> None:
    stage.broker.announce([POSES])
    stage.broker.received(POSE, b"nonsense", b"")
    stage.broker.received(POSE, b"x", b"\xff\xff")
    stage.frame(0, b"a", type_name="std_msgs/msg/String")
    stage.frame(1, b"a", topic="mqtt/other")
    stage.broker.received(POSE, b"", b"")
    assert stage.broker.malformed == 3


def test_each_topic_of_another_type_is_named_once(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    """With both types: nothing else says why such a topic never appears."""
    stage.broker.announce([POSES])
    for number in range(3):
        for agent in ("vehicle_00", "vehicle_01"):
            stage.frame(number, b"a", topic=f"mqtt/vehicles/{agent}/pose", type_name="std_msgs/msg/String")
    sentence = f"its messages are std_msgs/msg/String, not {TYPE}; change the topic's type"
    assert caplog.messages == [f"topic mqtt/vehicles/vehicle_0{number}/pose: {sentence}" for number in range(2)]


def test_definitions_come_with_the_messages(stage: Stage) -> None:
    odd = "other_msgs/msg/Odd"
    stage.broker.announce([TopicSettings(TopicPattern("/vehicles/{agent}/pose"), odd, MQTT)])
    topic = "robotkube/types/" + POSE
    for _ in range(2):
        stage.broker.received(topic, b"float64 x\n", type_properties(odd, "", ""))
    assert stage.learned == [odd]
    assert stage.broker.definitions == {odd: "float64 x\n"}
    stage.broker.received(topic, b"float64 x\n", b"")
    stage.broker.received(topic, b"#" * 1_000_001, type_properties(odd, "", ""))
    assert stage.broker.malformed == 2


def test_an_agent_defines_no_other_type_than_that_of_its_topic(stage: Stage) -> None:
    stage.broker.announce([POSES])
    for name, said in ((POSE, "tf2_msgs/msg/TFMessage"), ("mqtt/vehicles/vehicle_00/other", TYPE)):
        stage.broker.received("robotkube/types/" + name, b"float64 x\n", type_properties(said, "", ""))
    assert (stage.learned, stage.broker.definitions, stage.broker.malformed) == ([], {}, 2)


def test_an_installed_type_is_not_what_somebody_at_the_broker_says() -> None:
    odd = "other_msgs/msg/Odd"
    announced = {TYPE: "float64 turned_around\n", odd: "float64 x\n"}
    assert "\nPose pose\n" in definition(TYPE, announced)
    assert definition(odd, announced) == "float64 x\n"
    with pytest.raises(KeyError, match="Unheard"):
        definition("other_msgs/msg/Unheard", announced)


def test_gaps_of_senders_are_told(stage: Stage) -> None:
    stage.broker.announce([POSES])
    gap = Gap(NAME, "mqtt-bridge of vehicle-00", "waited too long", 3, 10, 30)
    for _ in range(2):  # a broker sends again what was on its way when the connection was lost
        stage.broker.received(POSE, encode_batch(1, 0, [b"a"]), type_properties(TYPE, "") + gaps_property([gap]))
    assert stage.gaps == [gap]


def test_a_topic_that_is_not_followed_any_more_is_given_up(stage: Stage) -> None:
    stage.connect()
    stage.broker.announce([POSES])
    stage.frame(0, b"a")
    stage.broker.announce([])
    assert (stage.channel.filters, stage.broker.visible()) == (set(), {})


def test_a_topic_that_was_forgotten_is_found_again_by_what_comes(stage: Stage) -> None:
    """Agents that are gone take no place from others."""
    stage.broker.announce([POSES])
    for number in range(TOPICS_MAX + 5):
        name = f"/vehicles/v{number}/pose"
        stage.frame(0, b"a", topic=f"mqtt{name}")
        assert stage.broker.visible() == {name: (TYPE,)}
        topic = stage.broker.subscribe(name, POSES, QosProfile())
        assert topic.drain(5) == [(b"a", 1_000)]
        topic.close()
        assert stage.broker.visible() == {}
    stage.frame(1, b"b")
    assert stage.broker.subscribe(NAME, POSES, QosProfile()).drain(5) == [(b"b", 1_000)]


def reaction(stage: Stage, box: DeadLetterBox, retry_seconds: float = 10.0) -> MqttReactions:
    settings = MqttReactionSettings("near", "events/near", True, retry_seconds)
    return MqttReactions(settings, stage.broker, box, lambda: stage.seconds)


def delivery(number: int) -> EdgeDelivery:
    return EdgeDelivery(f"{number}-start", START, "2" * 32, b"{}")


def test_messages_wait_for_the_broker_and_are_sent_again_in_order(stage: Stage) -> None:
    box = DeadLetterBox(lambda: 7)
    reactions = reaction(stage, box)
    for number in (1, 2):
        reactions.react(delivery(number))
    stage.broker.turn()
    assert (stage.channel.published, reactions.counts()["waiting"]) == ([], 2)
    assert reactions.unreachable == "not connected"
    stage.connect()
    stage.broker.turn()
    stage.broker.acknowledged(1, True)
    stage.broker.disconnected()
    stage.connect()
    stage.broker.turn()
    stage.broker.acknowledged(3, False)
    sent = [read_properties(properties) for _, _, _, properties in stage.channel.published]
    assert [said.user["id"] for said in sent] == ["1-start", "2-start", "2-start"]
    assert (sent[0].content_type, sent[0].user["trace"]) == ("application/json", "2" * 32)
    assert stage.channel.published[0][:3] == ("events/near", b"{}", True)
    assert reactions.counts() == {"delivered": 2, "retries": 1, "dead": 0, "waiting": 0}
    assert stage.broker.close(1.0, lambda _: None)
    assert stage.channel.closed


def test_what_the_broker_does_not_take_is_a_dead_letter(stage: Stage) -> None:
    box = DeadLetterBox(lambda: 7)
    reactions = reaction(stage, box)
    stage.connect()
    reactions.react(delivery(1))
    stage.broker.turn()
    stage.broker.rejected(1, "not authorised")
    stage.channel.complaint = "gone"
    reactions.react(delivery(2))
    stage.seconds = 11.0
    stage.broker.turn()
    for number in range(QUEUE_MAX + 1):
        reactions.react(delivery(100 + number))
    assert reactions.dead == 3
    assert not stage.broker.close(1.0, lambda _: None)
    reasons = [letter["reason"] for letter in box.documents()]
    assert reactions.dead == 3 + QUEUE_MAX
    assert reasons[-1] == "the detector ended"


def test_the_log_says_once_why_there_is_no_connection(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    for said in ("not connected", "Not authorized", "Not authorized", None, "does not answer"):
        stage.channel.complaint = said
        stage.broker.turn()
    assert [record.getMessage() for record in caplog.records] == ["broker: Not authorized", "broker: does not answer"]


def test_a_refused_subscription_is_named(stage: Stage) -> None:
    stage.connect()
    stage.broker.refused("robotkube/types/mqtt/x", "not authorised")
    assert stage.broker.unreachable == ""
    stage.broker.refused("mqtt/x", "not authorised")
    assert stage.broker.unreachable == "mqtt/x: not authorised"
