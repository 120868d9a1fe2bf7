"""The broker's rendered files, in a real mosquitto: who may connect, and that the process of the chart keeps the rights
of main there. What each right lets pass: tests/delivery/rights/test_broker.py."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
import yaml

from robotkube.delivery.rights import __main__ as process
from robotkube.foundation.certificates.adapters.issuing import issue, new_authority
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.robots.bridge.core.settings import read_bridge_settings
from robotkube.robots.bridge.loops.bridge import Bridge
from robotkube.robots.bridge.loops.flows import SendingSession
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel
from tests.stages import http_calls
from tests.stages.attacks import shown
from tests.stages.delivery.rights.main_of_links import POSE_00, Main, bridge
from tests.stages.delivery.rights.rights_broker import PLUGIN, SETTINGS, open_accounts, plugin, run_mosquitto
from tests.stages.delivery.tasks.mqtt_connection import ANSWER_SECONDS_MAX, NOT_AUTHORISED, Connection
from tests.stages.paths import CHARTS, SOURCE
from tests.stages.programs import free_port
from tests.stages.settings_mounted import mounted
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

PROFILES = Path(__file__).parent / "profiles"
PLATFORM = CHARTS / "robotkube"
BAD_ACCOUNT = {134, NOT_AUTHORISED}
MQTT_00 = f"mqtt{POSE_00}"

Connect = Callable[..., Connection]


@pytest.fixture(scope="module")
def official(helm: Any) -> Any:
    """The platform chart with two more vehicles, a road-side unit and an edge server, whose accounts are proved by
    passwords. By certificates: test_account_certificates.py."""
    profile = PROFILES / "official.yaml"
    agents = yaml.safe_load(profile.read_text())["agents"]
    more = [{"name": name, "role": "vehicle"} for name in ("vehicle-03", "vehicle-07")]
    more += [{"name": "roadside-0", "role": "roadside"}, {"name": "edge-0", "role": "edge"}]
    return helm.template(PLATFORM, profile, agents=[*agents, *more], tls={"accounts": "passwords"})


def logged(configuration: str) -> list[str]:
    """What a broker says of itself, in its log and as messages."""
    return [line for line in configuration.splitlines() if line.startswith(("log_", "connection_messages", "sys_"))]


@dataclass(frozen=True)
class Running:
    """A broker that runs; `tls`: how it proves who it is."""

    port: int
    tls: ServerVerification


@pytest.fixture(scope="module")
def broker(official: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """A mosquitto that runs on the rendered files, prepared by the init container's own command. Its certificate is for
    the names that the chart asks for, and for this machine's address."""
    folder = tmp_path_factory.mktemp("broker")
    folder.chmod(0o755)
    files = official.one("ConfigMap", "broker")["data"]
    (folder / "accounts.yaml").write_text(files["accounts.yaml"])
    passwords = official.one("Secret", "broker-accounts")["stringData"]["passwords"]
    (folder / "passwords").write_text(passwords)
    pod = dict(official.pods)["Deployment/broker"]
    [prepare] = pod["initContainers"]
    assert prepare["command"][0] == "robotkube-broker-accounts"
    assert prepare["env"][0] == {"name": "ROBOTKUBE_CONFIG", "value": "/etc/mosquitto/accounts.yaml"}
    file = folder / "run" / "dynamic-security.json"
    places = {"/accounts/passwords": str(folder / "passwords"), "/run/mosquitto/dynamic-security.json": str(file)}
    file.parent.mkdir()
    command = [sys.executable, "-m", "robotkube.delivery.rights.first_file"]
    command += [places[argument] for argument in prepare["command"][1:]]
    environment = {**os.environ, "PYTHONPATH": str(SOURCE), "ROBOTKUBE_CONFIG": str(folder / "accounts.yaml")}
    subprocess.run(command, check=True, timeout=20, env=environment)
    assert file.stat().st_mode & 0o077 == 0
    open_accounts(file)
    assert passwords.split(":")[1].split()[0] not in file.read_text()
    port = free_port()
    text = files["mosquitto.conf"]
    assert "1883" not in text
    assert logged(text) == logged(SETTINGS)
    text = text.replace("listener 8883", f"listener {port} 127.0.0.1\nuser root")
    text = text.replace("/etc/mosquitto-tls/", f"{folder}/")
    authority = new_authority("ours", time.time())
    settings = yaml.safe_load(official.one("ConfigMap", "certificates")["data"]["config.yaml"])
    (names,) = (one["names"] for one in settings["certificates"] if "broker" in one["names"])
    pair = issue(authority, [*names, "127.0.0.1"], time.time(), 3600)
    for name, pem in (("ca.crt", authority.certificate), ("tls.crt", pair.certificate), ("tls.key", pair.key)):
        (folder / name).write_text(pem)
    text = text.replace(f"plugin {PLUGIN}", f"plugin {plugin()}").replace("/run/mosquitto/", f"{folder}/run/")
    (folder / "mosquitto.conf").write_text(text)
    running = run_mosquitto(folder / "mosquitto.conf", port, folder / "log")
    try:
        yield Running(port, ServerVerification(folder / "ca.crt", names[0]))
    finally:
        running.terminate()
        running.wait(5)
    log = (folder / "log").read_text().splitlines()
    assert [line for line in log if "Warning" in line and "run as root" not in line] == []


@pytest.fixture
def connect(broker: Running, official: Any) -> Iterator[Connect]:
    made: list[Connection] = []

    def connect(account: str | None, password: str | None = None) -> Connection:
        if account is not None and password is None:
            platform = account in ("observer", "manager", "rights")
            place = (f"broker-account-{account}", None) if platform else ("broker-account", account)
            secret = official.one("Secret", *place)["stringData"]
            assert secret["username"] == account
            password = secret["password"]
        made.append(Connection(broker.port, account, password, tls=broker.tls))
        return made[-1]

    yield connect
    for connection in made:
        connection.close()


class Rights:
    """The process, with the settings that the chart mounts; main is in memory."""

    def __init__(self, official: Any, folder: Path, broker: Running) -> None:
        path = mounted(official, "rights", folder)
        document = yaml.safe_load(path.read_text())
        assert document["broker"]["authorities"] == str(folder / "authorities/ca.crt")
        at = {"host": "127.0.0.1", "port": broker.port, "authorities": str(broker.tls.authorities)}
        document["broker"] |= at
        document["listen"] = {"address": "127.0.0.1", "port": 0, "health_port": 0}
        path.write_text(yaml.safe_dump(document))
        self.main = Main()
        self.parts = process.RightsProcess(read_settings(path, process.read_configuration), self.main)
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self.parts.run, args=(self.stopping,))
        self.thread.start()

    def page(self, name: str) -> httpx.Response:
        return http_calls.get(f"http://127.0.0.1:{self.parts.server.ports['health_port']}/{name}")

    def close(self) -> None:
        self.stopping.set()
        self.thread.join(20)


@pytest.fixture
def rights(official: Any, broker: Running, tmp_path: Path) -> Iterator[Rights]:
    made = Rights(official, tmp_path, broker)
    yield made
    made.close()


@pytest.mark.parametrize("account", [(None, None), ("vehicle-00", "wrong"), ("nobody", "x"), ("vehicle-00", "")])
def test_refuses_no_account_and_wrong_ones(connect: Connect, account: tuple[str | None, str | None]) -> None:
    assert connect(*account).refused in BAD_ACCOUNT


def test_every_account_of_the_chart_is_known_and_begins_with_its_own_places(connect: Connect, official: Any) -> None:
    names = yaml.safe_load(official.one("ConfigMap", "broker")["data"]["accounts.yaml"])["agents"]
    for agent in names:
        own = agent["name"].replace("-", "_")
        connection = connect(agent["name"])
        connection.say(f"mqtt/agents/{own}/plan")
        speaks = connection.publish(f"mqtt/vehicles/{own}/pose") != NOT_AUTHORISED
        assert speaks == (agent["role"] in ("vehicle", "roadside"))
    assert connect("observer").subscribe("mqtt/#") == 1
    assert connect("manager").subscribe("robotkube/tasks/vehicle-03") == 1
    assert connect("cloud-0").subscribe("mqtt/#") == NOT_AUTHORISED


def test_the_process_gives_what_main_says_and_tells_that_it_did(connect: Connect, rights: Rights) -> None:
    until(lambda: rights.page("readyz").status_code == 200, "ready")
    cloud, vehicle = connect("cloud-0"), connect("vehicle-00")
    assert cloud.subscribe("mqtt/vehicles/+/pose") == NOT_AUTHORISED
    rights.parts.follower.wake(rights.main.put(bridge("cloud-0", "/vehicles/{agent}/pose")))
    until(lambda: cloud.subscribe("mqtt/vehicles/+/pose") == 1, "the right")
    vehicle.say(MQTT_00)
    assert cloud.topics(1) == [MQTT_00]
    until(lambda: rights.page("readyz").status_code == 200, "ready")
    metrics = rights.page("metrics").text
    for line in ("granted 1.0", "behind 0.0", "restored_total 0.0"):
        assert f"\nrobotkube_rights_{line}\n" in metrics
    rights.parts.follower.wake(rights.main.put())
    until(lambda: cloud.subscribe("mqtt/vehicles/+/pose") == NOT_AUTHORISED, "the right is gone")


def test_a_bridge_that_may_not_says_so(broker: Running, official: Any) -> None:
    """The bridge of vehicle-07, told to send vehicle-03's pose: it names it, counts a refusal, sends nothing."""
    secret = official.one("Secret", "broker-account", "vehicle-07")["stringData"]
    assert (secret["host"], secret["port"], secret["tls"]) == (broker.tls.name, "8883", "required")
    account = BrokerAccount("127.0.0.1", broker.port, secret["username"], secret["password"], broker.tls)
    waiting = [b"pose"]
    source = SimpleNamespace(take=lambda _: [waiting.pop()] if waiting else [], matched=1, close=lambda: None)
    network: Any = SimpleNamespace(subscribe=lambda *_: source)

    def channel(agent: str, name: str, events: Any) -> PahoChannel:
        return PahoChannel(lambda: account, f"{agent}-{name}", 5, events)

    sender = SendingSession(1, time.time_ns, lambda name: "")
    refused = Bridge(network, channel, sender, lambda *a, **k: None, Fencing())
    pose = {"name": "/vehicles/vehicle_03/pose", "type": "geometry_msgs/msg/PoseStamped"}
    refused.configure(read_bridge_settings({"agent": "vehicle-07", "out": [pose]}, "config.yaml"))
    deadline = time.monotonic() + ANSWER_SECONDS_MAX
    while "`robotkube agent rights`" not in str(refused.not_carried):
        assert time.monotonic() < deadline, (refused.complaint, refused.not_carried)
        refused.turn(time.monotonic())
        time.sleep(0.01)
    [sentence] = refused.not_carried
    assert sentence.startswith("mqtt/vehicles/vehicle_03/pose: ")
    shown("elsewhere", sentence, "topic-of-another")
    assert refused.complaint is None
    assert 'why="refused by the broker"} 1' in refused.metrics()
    refused.close()


def test_four_point_clouds_fit_into_one_message(connect: Connect) -> None:
    reader, vehicle = connect("observer"), connect("vehicle-00")
    reader.subscribe("mqtt/#")
    cloud = bytes(20_000 * 16 * 4)
    vehicle.say("mqtt/vehicles/vehicle_00/lidar_center/pointcloud", cloud)
    reader.topics(1)
    assert [len(payload) for _, payload in reader.received] == [len(cloud)]
