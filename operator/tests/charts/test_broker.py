"""The broker's rendered files, in a real mosquitto: who may connect, and who may read and write what."""

from __future__ import annotations

import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import paho.mqtt.client as mqtt
import pytest
import yaml
from paho.mqtt.enums import CallbackAPIVersion

from robotkube.delivery.manager.core.placement.placement import Agent
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.robots.bridge.core.rights import IN, OUT, may
from robotkube.robots.bridge.core.settings import GATEWAY_TOPICS, BridgedTopic, read_bridge_settings
from robotkube.robots.bridge.loops.bridge import Bridge
from robotkube.robots.bridge.loops.flows import SendingSession
from robotkube.robots.mqtt.adapters.paho_channel import BrokerAccount, PahoChannel
from tests.stages.paths import CHARTS
from tests.stages.programs import free_port

pytestmark = pytest.mark.toolchain

START_SECONDS_MAX = 30.0
ANSWER_SECONDS_MAX = 30.0
PROFILES = Path(__file__).parent / "profiles"
PLATFORM = CHARTS / "robotkube"
WRITER = "writer"  # an account of these tests alone, which writes what nobody else may

Connect = Callable[..., "Connection"]


class Connection:
    """One MQTT 5 connection: `received` collects messages; publishing and subscribing give the broker's reason code."""

    def __init__(self, port: int, username: str | None, password: str | None) -> None:
        self.received: list[tuple[str, bytes]] = []
        self.arrived = threading.Condition()
        self.refused: int | None = None
        self._answers: dict[int, int] = {}
        self._connected = threading.Event()
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5, reconnect_on_failure=False)
        if username is not None:
            self._client.username_pw_set(username, password)
        self._client.on_connect = self._on_connect
        self._client.on_message = self._on_message
        self._client.on_publish = lambda _c, _u, mid, code, _p: self._answer(mid, code.value)
        self._client.on_subscribe = lambda _c, _u, mid, codes, _p: self._answer(mid, codes[0].value)
        self._client.connect("127.0.0.1", port, keepalive=10)
        self._client.loop_start()
        assert self._connected.wait(ANSWER_SECONDS_MAX)

    def _on_connect(self, _client: Any, _data: Any, _flags: Any, code: Any, _properties: Any) -> None:
        self.refused = code.value if code.is_failure else None
        self._connected.set()

    def _on_message(self, _client: Any, _data: Any, message: Any) -> None:
        with self.arrived:
            self.received.append((message.topic, message.payload))
            self.arrived.notify_all()

    def _answer(self, mid: int, code: int) -> None:
        with self.arrived:
            self._answers[mid] = code
            self.arrived.notify_all()

    def _code(self, mid: int) -> int:
        with self.arrived:
            assert self.arrived.wait_for(lambda: mid in self._answers, ANSWER_SECONDS_MAX), "no answer"
            return self._answers[mid]

    def subscribe(self, topic: str) -> int:
        _, mid = self._client.subscribe(topic, qos=1)
        assert mid is not None
        return self._code(mid)

    def publish(self, topic: str, payload: bytes = b"x") -> int:
        return self._code(self._client.publish(topic, payload, qos=1).mid)

    def topics(self, count: int) -> list[str]:
        """The topics received, once `count` have come: the broker hands out in the order in which it takes, so what it
        took before and should not hand out would be among them."""
        with self.arrived:
            self.arrived.wait_for(lambda: len(self.received) >= count, ANSWER_SECONDS_MAX)
            return [topic for topic, _ in self.received]

    def until(self, payload: bytes) -> set[str]:
        """The topics received, once this payload has come."""
        with self.arrived:
            came = self.arrived.wait_for(lambda: any(p == payload for _, p in self.received), ANSWER_SECONDS_MAX)
            assert came, self.received
            return {topic for topic, _ in self.received}

    def close(self) -> None:
        client = self._client
        client.disconnect()
        client.loop_stop()
        client.on_connect = client.on_message = client.on_publish = client.on_subscribe = (
            None  # they hold it in a circle
        )


@pytest.fixture(scope="module")
def official(helm: Any) -> Any:
    """The platform chart with two more vehicles, a road-side unit and an edge server."""
    profile = PROFILES / "official.yaml"
    agents = yaml.safe_load(profile.read_text())["agents"]
    more = [{"name": name, "role": "vehicle"} for name in ("vehicle-03", "vehicle-07")]
    more += [{"name": "roadside-0", "role": "roadside"}, {"name": "edge-0", "role": "edge"}]
    return helm.template(PLATFORM, profile, agents=[*agents, *more])


@pytest.fixture(scope="module")
def broker(official: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Port of a mosquitto that runs on the rendered files, prepared by the init container's own command."""
    folder = tmp_path_factory.mktemp("broker")
    folder.chmod(0o755)
    files = official.one("ConfigMap", "broker")["data"]
    (folder / "settings").mkdir()
    (folder / "accounts").mkdir()
    (folder / "run").mkdir()
    (folder / "settings" / "acl").write_text(f"{files['acl']}\nuser {WRITER}\ntopic readwrite #\n")
    passwords = official.one("Secret", "broker-accounts")["stringData"]["passwords"].rstrip() + f"\n{WRITER}:{WRITER}\n"
    (folder / "accounts" / "passwords").write_text(passwords)
    pod = dict(official.pods)["Deployment/broker"]
    [script] = pod["initContainers"][0]["args"]
    places = {"/accounts/": f"{folder}/accounts/", "/etc/mosquitto/": f"{folder}/settings/"}
    places["/run/mosquitto/"] = f"{folder}/run/"
    for place, here in places.items():
        script = script.replace(place, here)
    subprocess.run(["sh", "-ec", script], check=True, timeout=20)
    for name in ("passwords", "acl"):
        assert (folder / "run" / name).stat().st_mode & 0o077 == 0
    assert passwords.split(":")[1][:60] not in (folder / "run" / "passwords").read_text()
    port = free_port()
    text = files["mosquitto.conf"].replace("listener 1883", f"listener {port} 127.0.0.1\nuser root")
    (folder / "mosquitto.conf").write_text(text.replace("/run/mosquitto/", f"{folder}/run/"))
    yield from running(folder / "mosquitto.conf", port)


def running(configuration: Path, port: int) -> Iterator[int]:
    log = configuration.with_suffix(".log")
    with log.open("wb") as sink:
        process = subprocess.Popen(["mosquitto", "-c", str(configuration)], stdout=sink, stderr=sink)
    try:
        deadline = time.monotonic() + START_SECONDS_MAX
        while True:
            assert process.poll() is None, log.read_text()
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
                break
            except OSError:
                assert time.monotonic() < deadline, log.read_text()
                time.sleep(0.02)
        yield port
    finally:
        process.terminate()
        process.wait(5)
    warnings = [line for line in log.read_text().splitlines() if "Warning" in line and "run as root" not in line]
    assert warnings == []


@pytest.fixture
def connect(broker: int, official: Any) -> Iterator[Connect]:
    made: list[Connection] = []

    def connect(account: str | None, password: str | None = None) -> Connection:
        if account is not None and password is None:
            platform = account in ("observer", "manager")
            place = (f"broker-account-{account}", None) if platform else ("broker-account", account)
            secret = official.one("Secret", *place)["stringData"]
            assert secret["username"] == account
            password = secret["password"]
        made.append(Connection(broker, account, password))
        return made[-1]

    yield connect
    for connection in made:
        connection.close()


NOT_AUTHORISED = 135
BAD_ACCOUNT = {134, NOT_AUTHORISED}


@pytest.mark.parametrize("account", [(None, None), ("vehicle-00", "wrong"), ("nobody", "x"), ("vehicle-00", "")])
def test_refuses_no_account_and_wrong_ones(connect: Connect, account: tuple[str | None, str | None]) -> None:
    assert connect(*account).refused in BAD_ACCOUNT


def test_a_vehicle_writes_and_reads_its_own_topics(connect: Connect) -> None:
    vehicle = connect("vehicle-00")
    assert vehicle.subscribe("mqtt/vehicles/vehicle_00/#") == 1
    assert vehicle.publish("mqtt/vehicles/vehicle_00/pose") == 0
    assert vehicle.topics(1) == ["mqtt/vehicles/vehicle_00/pose"]


@pytest.mark.parametrize(
    "topic", ["mqtt/vehicles/vehicle_01/pose", "mqtt/vehicles/vehicle_000/pose", "mqtt/other", "robotkube/tasks/x", "x"]
)
def test_a_vehicle_writes_nothing_else(connect: Connect, topic: str) -> None:
    assert connect("vehicle-00").publish(topic) == NOT_AUTHORISED


def test_vehicle_07_does_not_publish_the_pose_of_vehicle_03(connect: Connect) -> None:
    cloud, impostor, owner = connect("cloud-0"), connect("vehicle-07"), connect("vehicle-03")
    cloud.subscribe("mqtt/vehicles/+/pose")
    assert impostor.publish("mqtt/vehicles/vehicle_03/pose", b"forged") == NOT_AUTHORISED
    assert owner.publish("mqtt/vehicles/vehicle_03/pose", b"own") == 0
    cloud.topics(1)
    assert cloud.received == [("mqtt/vehicles/vehicle_03/pose", b"own")]


@pytest.mark.parametrize("prefix", ["robotkube/types", "mqtt_client/ros_msg_type"])
def test_a_vehicle_says_of_its_own_topics_what_they_are(connect: Connect, prefix: str) -> None:
    cloud, vehicle = connect("cloud-0"), connect("vehicle-00")
    cloud.subscribe(f"{prefix}/mqtt/vehicles/+/pose")
    assert vehicle.publish(f"{prefix}/mqtt/vehicles/vehicle_01/pose") == NOT_AUTHORISED
    assert cloud.publish(f"{prefix}/mqtt/vehicles/vehicle_00/pose") == NOT_AUTHORISED
    assert vehicle.publish(f"{prefix}/mqtt/vehicles/vehicle_00/pose") == 0
    assert cloud.topics(1) == [f"{prefix}/mqtt/vehicles/vehicle_00/pose"]


AGENTS = [
    Agent(name, role, name)
    for name, role in [("vehicle-00", "vehicle"), ("roadside-0", "roadside"), ("cloud-0", "cloud"), ("edge-0", "edge")]
]
TOPICS = [
    *(f"/vehicles/{name}" for name in ("vehicle_00", "vehicle_00/pose", "vehicle_000/pose", "vehicle_03/pose")),
    *("/vehicles/vehicle_00/a/b", "/vehicles/roadside_0/pose", "/vehicles/roadside_00/pose", "/vehicles/pose"),
    *("/vehicles/cloud_0/plan", "/vehicles/edge_0/plan", "/pose", "/robotkube/tasks", "/robotkube/task_status"),
]


@pytest.mark.parametrize("agent", AGENTS, ids=lambda agent: agent.name)
def test_links_are_composed_of_what_the_broker_lets_pass(connect: Connect, agent: Agent) -> None:
    """`may` and the rendered file say the same of every agent, direction and topic."""
    bridge, writer = connect(agent.name), connect(WRITER, WRITER)
    at_broker = {name: at_the_broker(name, agent) for name in TOPICS}
    written = {name for name in TOPICS if bridge.publish(at_broker[name]) != NOT_AUTHORISED}
    assert written == {name for name in TOPICS if may(agent, OUT, name)}
    for name in at_broker.values():
        bridge.subscribe(name)
        writer.publish(name)
    writer.publish(f"robotkube/task_status/{agent.name}", b"the last one")
    received = bridge.until(b"the last one")
    assert {name for name in TOPICS if at_broker[name] in received} == {n for n in TOPICS if may(agent, IN, n)}


def at_the_broker(name: str, agent: Agent) -> str:
    """The MQTT topic of a ROS topic in the bridge of an agent."""
    return BridgedTopic(name, "", gateway_agent=agent.name if name in GATEWAY_TOPICS else "").mqtt


def test_a_bridge_that_may_not_says_so(broker: int, official: Any) -> None:
    """The bridge of vehicle-07, told to send vehicle-03's pose: it names it, counts a refusal, sends nothing."""
    secret = official.one("Secret", "broker-account", "vehicle-07")["stringData"]
    account = BrokerAccount("127.0.0.1", broker, secret["username"], secret["password"])
    waiting = [b"pose"]
    source = SimpleNamespace(take=lambda _: [waiting.pop()] if waiting else [], matched=1, close=lambda: None)
    network: Any = SimpleNamespace(subscribe=lambda *_: source)

    def channel(agent: str, name: str, events: Any) -> PahoChannel:
        return PahoChannel(lambda: account, f"{agent}-{name}", 5, events)

    sender = SendingSession(1, time.time_ns, lambda name: "")
    bridge = Bridge(network, channel, sender, lambda *a, **k: None, Fencing())
    pose = {"name": "/vehicles/vehicle_03/pose", "type": "geometry_msgs/msg/PoseStamped"}
    bridge.configure(read_bridge_settings({"agent": "vehicle-07", "out": [pose]}, "config.yaml"))
    deadline = time.monotonic() + ANSWER_SECONDS_MAX
    while "look at the broker's ACL" not in str(bridge.not_carried):
        assert time.monotonic() < deadline, (bridge.complaint, bridge.not_carried)
        bridge.turn(time.monotonic())
        time.sleep(0.01)
    assert "mqtt/vehicles/vehicle_03/pose: the broker refuses a message (reason 0x87" in str(bridge.not_carried)
    assert bridge.complaint is None
    assert 'why="refused by the broker"} 1' in bridge.metrics()
    bridge.close()


def test_a_vehicle_reads_no_other_vehicle(connect: Connect) -> None:
    listener, other = connect("vehicle-01"), connect("vehicle-00")
    listener.subscribe("mqtt/#")
    listener.subscribe("mqtt/vehicles/vehicle_00/#")
    assert other.publish("mqtt/vehicles/vehicle_00/pose") == 0
    assert listener.publish("mqtt/vehicles/vehicle_01/pose") == 0
    assert listener.topics(1) == ["mqtt/vehicles/vehicle_01/pose"]


@pytest.mark.parametrize("account", ["cloud-0", "observer"])
def test_cloud_and_observer_read_all_and_write_nothing(connect: Connect, account: str) -> None:
    reader, vehicle = connect(account), connect("vehicle-00")
    assert reader.subscribe("mqtt/#") == 1
    assert reader.publish("mqtt/vehicles/vehicle_00/pose") == NOT_AUTHORISED
    assert vehicle.publish("mqtt/vehicles/vehicle_00/pose") == 0
    assert reader.topics(1) == ["mqtt/vehicles/vehicle_00/pose"]


@pytest.mark.parametrize("agent", ["vehicle-00", "cloud-0"])
def test_an_agent_asks_on_its_own_topic_and_hears_its_own_answers(connect: Connect, agent: str) -> None:
    operator, other, manager = connect(agent), connect("vehicle-01"), connect("manager")
    manager.subscribe("robotkube/tasks/#")
    for reader in (operator, other):
        reader.subscribe(f"robotkube/task_status/{agent}")
    other.subscribe("robotkube/task_status/vehicle-01")
    assert operator.publish(f"robotkube/tasks/{agent}") == 0
    assert manager.topics(1) == [f"robotkube/tasks/{agent}"]
    assert manager.publish(f"robotkube/task_status/{agent}") == 0
    assert operator.topics(1) == [f"robotkube/task_status/{agent}"]
    assert manager.publish("robotkube/task_status/vehicle-01") == 0
    assert other.topics(1) == ["robotkube/task_status/vehicle-01"]
    assert other.publish(f"robotkube/tasks/{agent}") == NOT_AUTHORISED
    assert operator.publish(f"robotkube/task_status/{agent}") == NOT_AUTHORISED


def test_an_agent_holds_changes_of_its_own_only(connect: Connect) -> None:
    manager, vehicle = connect("manager"), connect("vehicle-00")
    manager.subscribe("robotkube/holds/#")
    assert vehicle.publish("robotkube/holds/vehicle-00") == 0
    assert vehicle.publish("robotkube/holds/vehicle-01") == NOT_AUTHORISED
    assert manager.topics(1) == ["robotkube/holds/vehicle-00"]
    assert manager.publish("robotkube/holds/vehicle-00") == NOT_AUTHORISED


def test_an_agent_does_not_hear_what_others_ask(connect: Connect) -> None:
    listener, other = connect("vehicle-01"), connect("vehicle-00")
    listener.subscribe("robotkube/tasks/#")
    listener.subscribe("robotkube/tasks/vehicle-00")
    listener.subscribe("mqtt/vehicles/vehicle_01/#")
    assert other.publish("robotkube/tasks/vehicle-00") == 0
    assert listener.publish("mqtt/vehicles/vehicle_01/pose") == 0
    assert listener.topics(1) == ["mqtt/vehicles/vehicle_01/pose"]


def test_the_manager_has_nothing_to_do_with_robots_data(connect: Connect) -> None:
    manager, vehicle = connect("manager"), connect("vehicle-00")
    manager.subscribe("mqtt/#")
    manager.subscribe("robotkube/tasks/#")
    assert vehicle.publish("mqtt/vehicles/vehicle_00/pose") == 0
    assert vehicle.publish("robotkube/tasks/vehicle-00") == 0
    assert manager.topics(1) == ["robotkube/tasks/vehicle-00"]
    assert manager.publish("mqtt/vehicles/vehicle_00/pose") == NOT_AUTHORISED
    assert manager.publish("robotkube/tasks/vehicle-00") == NOT_AUTHORISED


def test_four_point_clouds_fit_into_one_message(connect: Connect) -> None:
    reader, vehicle = connect("cloud-0"), connect("vehicle-00")
    reader.subscribe("mqtt/#")
    cloud = bytes(20_000 * 16 * 4)
    assert vehicle.publish("mqtt/vehicles/vehicle_00/lidar_center/pointcloud", cloud) == 0
    reader.topics(1)
    assert [len(payload) for _, payload in reader.received] == [len(cloud)]
