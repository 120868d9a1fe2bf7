"""What others can read at a real broker: mqtt_client's format, types that are not installed, what the how-to shows."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import pytest

from benchmarks.measuring import pods
from robotkube.robots.bridge.core import mqtt_client_format as ika
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel
from robotkube.robots.mqtt.core.batches import decode_batch, encode_batch
from robotkube.robots.mqtt.core.message_properties import type_properties, types_topic
from robotkube.robots.mqtt.core.properties import read_properties
from robotkube.robots.ros.core.cdr import CdrWriter, Header
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from tests.stages.bridge.two_bridges import Stage, running
from tests.stages.paths import DOCS

pytestmark = pytest.mark.processes

POSE = {"name": "/vehicles/vehicle_00/pose", "type": "geometry_msgs/msg/PoseStamped"}
IKA = {**POSE, "format": "mqtt_client", "inject_timestamp": True}
HOW_TO = DOCS / "how-to" / "connect-mqtt-client.md"
TF = "tf2_msgs/msg/TFMessage"
TF_TOPIC = "mqtt/vehicles/vehicle_00/tf"
LINE = "=" * 80
TF_DEFINITION = f"""geometry_msgs/TransformStamped[] transforms
{LINE}
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
{LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{LINE}
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
{LINE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{LINE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""


class Client:
    """A connection of somebody who is no bridge."""

    def __init__(self, stage: Stage, account: str) -> None:
        self.stage = stage
        self.got = dict[str, tuple[bytes, bytes]]()
        credentials = BrokerAccount("127.0.0.1", stage.broker.port, account, pods.password(account))
        self.channel = PahoChannel(lambda: credentials, f"{account}-client", 5, self)
        self.until(lambda: self.channel.complaint is None)

    def until(self, condition: Any) -> None:
        def turned() -> Any:
            self.channel.turn(time.monotonic())
            self.channel.flush()
            return condition()

        self.stage.until(turned)

    def connected(self, session_kept: bool) -> None: ...

    def disconnected(self) -> None: ...

    def acknowledged(self, token: int, heard: bool) -> None: ...

    def rejected(self, token: int, reason: str) -> None:
        raise AssertionError(reason)

    def refused(self, topic: str, reason: str) -> None:
        raise AssertionError(f"{topic}: {reason}")

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        self.got[topic] = (payload, properties)


@pytest.mark.parametrize("name", [POSE["name"], "/vehicles/{agent}/pose"])
def test_bridges_speak_mqtt_client_with_each_other_and_with_others(tmp_path: Path, name: str) -> None:
    with running(tmp_path) as stage:
        stage.vehicle.configure(out=[IKA])
        stage.cloud.configure(**{"in": [{**POSE, "format": "mqtt_client", "name": name}]})
        stage.ready()
        client = Client(stage, "cloud-0")
        topic = "mqtt" + POSE["name"]
        client.channel.subscribe([topic, ika.type_topic(topic)])
        client.until(lambda: ika.type_topic(topic) in client.got)
        assert ika.decode_type(client.got[ika.type_topic(topic)][0]) == ika.RosMessageType(POSE["type"], True)
        before = time.time_ns()
        stage.play(0.5, (POSE, 100.0))
        stage.drained(POSE)
        assert stage.received(POSE) == list(range(stage.sent[POSE["name"]]))
        client.until(lambda: topic in client.got)
        last, stamp = ika.decode_message(client.got[topic][0], stamped=True)
        assert last in stage.cloud.endpoint(POSE).published
        assert before <= (stamp or 0) <= time.time_ns()
        client.channel.close()


def test_a_type_that_is_not_installed_is_read_by_its_definition(tmp_path: Path) -> None:
    """tf2_msgs: a sender with the package retains the definition, and a reader without it takes what it wants."""
    writer = CdrWriter()
    writer.number("I", 1)
    writer.header(Header(7, "map"))
    writer.text("base")
    for value in (1.5, 2.5, 3.5, 0.0, 0.0, 0.0, 1.0):
        writer.number("d", value)
    with running(tmp_path) as stage:
        sender = Client(stage, "vehicle-00")
        sender.channel.publish(types_topic(TF_TOPIC), TF_DEFINITION.encode(), True, type_properties(TF, "", ""))
        batch = encode_batch(1, 0, [bytes(writer.data)])
        sender.channel.publish(TF_TOPIC, batch, True, type_properties(TF, "ab" * 16))
        reader = Client(stage, "cloud-0")
        reader.channel.subscribe(["mqtt/vehicles/+/tf", "robotkube/types/mqtt/vehicles/+/tf"])
        sender.until(lambda: True)
        reader.until(lambda: len(reader.got) == 2)
        definition, payload = reader.got[types_topic(TF_TOPIC)], reader.got[TF_TOPIC]
        kinds = {read_properties(definition[1]).user["type"]: definition[0].decode()}
        kind = read_properties(payload[1]).user["type"]
        assert kind == TF
        fields = Layouts(kinds.__getitem__).reader(
            kind, ["transforms[0].child_frame_id", "transforms[0].transform.translation.y"]
        )
        assert fields(decode_batch(payload[0]).messages[0]) == ("base", 2.5)
        sender.channel.close()
        reader.channel.close()


def test_definitions_are_retained_beside_the_messages(tmp_path: Path) -> None:
    with running(tmp_path) as stage:
        stage.vehicle.configure(out=[POSE], publish_types=True)
        stage.cloud.configure()
        stage.ready()
        client = Client(stage, "cloud-0")
        topic = types_topic("mqtt" + POSE["name"])
        client.channel.subscribe([topic])
        client.until(lambda: topic in client.got)
        assert client.got[topic][0] == b"definition of " + POSE["type"].encode()
        client.channel.close()


def test_the_how_to_reads_batches() -> None:
    [code] = re.findall(r"```python\n(.*?)```", HOW_TO.read_text(), re.DOTALL)
    known: dict[str, Any] = {}
    exec(code, known)  # noqa: S102 - the page's own example
    assert known["messages"](encode_batch(5, 6, [b"a", b"", b"bcd"])) == (5, 6, [b"a", b"", b"bcd"])
