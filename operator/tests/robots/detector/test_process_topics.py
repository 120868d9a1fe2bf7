"""The detector's process beside real publishers: their quality of service, its states, its first buffers."""

from __future__ import annotations

import http.client
import json
import signal
import socket
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.robots.bags.adapters.writing import BagWriter
from robotkube.robots.bags.core.playback import BagTopic
from tests.stages.detector.in_memory import pose
from tests.stages.detector.process import COMMAND, PUBLISHER, Api, is_up, read
from tests.stages.detector.proximity_settings import SETTINGS
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

QUALITY_PUBLISHER = ("-m", "tests.stages.ros.qos_publisher")
POSE, NUMBER = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/Float64"
MS, SECOND = 1_000_000, 1_000_000_000
SWITCHES = 2
QUIET = {key: value for key, value in SETTINGS.items() if key != "reactions"}

Start = Callable[..., subprocess.Popen[str]]


class Detector:
    """A detector's process and its pages."""

    def __init__(self, start: Start, folder: Path, port: int, settings: dict[str, Any], **environment: str) -> None:
        (folder / "config.yaml").write_text(write_mapping(settings))
        self.port = port
        paths = {"ROBOTKUBE_CONFIG": str(folder / "config.yaml"), "ROBOTKUBE_HEALTH_PORT": str(port)}
        self.process = start(*COMMAND, **paths, **environment)
        until(lambda: is_up(port))

    def status(self) -> Any:
        return json.loads(read(self.port, "/status"))

    def topic(self, name: str) -> Any:
        return self.status()["topics"][name]

    def events(self) -> list[str]:
        return [event["edge"] for event in json.loads(read(self.port, "/events"))["events"]]

    def switch(self, state: str) -> None:
        read(self.port, "/state", json.dumps({"state": state}).encode())
        until(lambda: self.status()["state"] == state)

    def metric(self, line: str) -> bool:
        return f"robotkube_detector_{line}" in read(self.port, "/metrics").splitlines()


def test_quality_of_service_is_that_of_whoever_publishes(start: Start, tmp_path: Path, unused_port: int) -> None:
    """A strong publisher comes after the subscription: what it said before is there, and its promises are asked for. A
    weak one beside it: both are heard, in the same buffer. A topic whose settings insist names whom it cannot hear."""
    topics: list[dict[str, Any]] = [{"name": "/open", "type": NUMBER, "buffer": {"seconds": 600}}]
    topics.append({"name": "/strict", "type": NUMBER, "durability": "transient_local"})
    detector = Detector(start, tmp_path, unused_port, {"name": "cloud-0/d", "topics": topics})
    assert detector.topic("/open")["asked"] == "reliable, volatile"
    strong = {"durability": "transient_local", "deadline": 0.5, "lease": 2}
    start(*QUALITY_PUBLISHER, "/open", json.dumps(strong))
    expected = "reliable, transient_local, deadline 0.5 s, liveliness manual_by_topic 2 s"
    until(lambda: detector.topic("/open")["asked"] == expected)
    until(lambda: detector.topic("/open")["received"] > 0)
    shown = detector.topic("/open")
    assert (shown["problem"], [offer["quality"] for offer in shown["offered"]]) == ("", [expected])
    until(lambda: detector.metric('matched_sources{topic="/open"} 1'))
    held = detector.topic("/open")["buffer"]["messages"]
    start(*QUALITY_PUBLISHER, "/open", json.dumps({"reliability": "best_effort"}))
    until(lambda: detector.topic("/open")["asked"] == "best_effort, volatile")
    until(lambda: detector.metric('matched_sources{topic="/open"} 2'))
    shown = detector.topic("/open")
    assert (shown["problem"], shown["buffer"]["cleared"]) == ("", 0)
    assert shown["buffer"]["messages"] >= held
    assert shown["incompatible"] == {"count": 1, "policy": "reliability"}, "that of the subscription before"
    until(lambda: detector.topic("/open")["received"] > shown["received"] + 40)
    assert detector.topic("/open")["lost"] == 0, "each publisher numbers its own messages"

    weak = start(*QUALITY_PUBLISHER, "/strict", "{}")
    until(lambda: detector.topic("/strict")["problem"].startswith("/publisher_"))
    sentence = "does not fit: durability: asked transient_local, offered volatile"
    assert detector.topic("/strict")["problem"].endswith(sentence)
    until(lambda: detector.topic("/strict")["incompatible"] == {"count": 1, "policy": "durability"})
    assert detector.metric('mismatched_topics{topic="/strict"} 1')
    assert detector.metric('incompatible_total{topic="/strict"} 1')
    weak.terminate()  # it says that it goes; of one that is killed the middleware knows after 20 s
    start(*QUALITY_PUBLISHER, "/strict", json.dumps({"durability": "transient_local"}))
    until(lambda: detector.topic("/strict")["received"] > 0)
    until(lambda: detector.topic("/strict")["problem"] == "")
    assert detector.metric('mismatched_topics{topic="/strict"} 0')
    detector.process.terminate()
    _, log = detector.process.communicate(timeout=10)
    events = [json.loads(line)["event"] for line in log.splitlines() if line.startswith("{")]
    assert any(event.startswith("topic /strict: ") and event.endswith(sentence) for event in events)
    assert any("the middleware has refused publishers because of durability" in event for event in events)
    refused = "topic /open: the middleware has refused publishers because of reliability (1 so far): asked reliable, "
    assert any(event.startswith(refused) for event in events), "what was asked for when it refused"
    assert any(event.startswith("topic /strict: every publisher fits") for event in events)


def test_promises_that_a_publisher_breaks_are_counted(start: Start, tmp_path: Path, unused_port: int) -> None:
    """It is stopped as a whole, as a process that hangs: it misses its deadline again and again, and shows
    no sign of life."""
    topics = [{"name": "/promised", "type": NUMBER}]
    detector = Detector(start, tmp_path, unused_port, {"name": "cloud-0/d", "topics": topics})
    publisher = start(*QUALITY_PUBLISHER, "/promised", json.dumps({"deadline": 0.5, "lease": 2}))
    expected = "reliable, volatile, deadline 0.5 s, liveliness manual_by_topic 2 s"
    until(lambda: detector.topic("/promised")["asked"] == expected)
    known = detector.topic("/promised")["received"]
    # by the subscription before this one, too, which asked for nothing; the middleware counts from a first message on
    until(lambda: detector.topic("/promised")["received"] > known + 20)
    before = detector.topic("/promised")
    publisher.send_signal(signal.SIGSTOP)
    until(lambda: detector.topic("/promised")["missed_deadlines"] >= before["missed_deadlines"] + 3)
    until(lambda: detector.topic("/promised")["lost_liveliness"] > before["lost_liveliness"])
    silent = detector.topic("/promised")
    publisher.send_signal(signal.SIGCONT)
    until(lambda: detector.topic("/promised")["received"] > silent["received"])
    for key in ("missed_deadlines", "lost_liveliness"):
        lines = read(unused_port, "/metrics").splitlines()
        label = f'robotkube_detector_{key}_total{{topic="/promised"}} '
        [shown] = [int(line.removeprefix(label)) for line in lines if line.startswith(label)]
        assert silent[key] <= shown <= detector.topic("/promised")[key]


def test_it_becomes_active_by_command_and_by_configuration_with_all_it_has(
    api: Api, start: Start, tmp_path: Path, unused_port: int
) -> None:
    """Subscriptions are there already, buffers stay, the next message after it raises; and back again, several times.
    How long it takes is measured by benchmarks; here it only has to be said."""
    document = {**QUIET, "topics": [{**QUIET["topics"][0], "buffer": {"seconds": 60}}]}
    api.settings = write_mapping({**document, "state": "buffering"})
    detector = Detector(
        start, tmp_path, unused_port, {**document, "state": "buffering"},
        ROBOTKUBE_API_SERVER=f"http://127.0.0.1:{api.server_port}", ROBOTKUBE_CONFIGMAP="cloud-0/event-detector",
    )  # fmt: skip
    start(*PUBLISHER, str(tmp_path), "60")
    name = "/vehicles/vehicle_01/pose"
    until(lambda: detector.topic(name)["received"] > 10)
    assert detector.events() == []
    held = 0
    asked = list[int]()

    def configure(state: str) -> None:
        api.settings = write_mapping({**document, "state": state})
        api.changed.set()
        until(lambda: detector.status()["state"] == state)

    ways = [(detector.switch, "active"), (detector.switch, "buffering"), (configure, "active"),
            (configure, "inactive"), (configure, "buffering")]  # fmt: skip
    for way, state in ways * SWITCHES:
        way(state)
        status = detector.status()
        assert status["state_since"] >= status["state_asked"]
        asked.append(status["state_asked"])
        if state == "inactive":
            assert status["topics"] == {}
            continue
        buffer = status["topics"][name]["buffer"]
        assert (buffer["cleared"], buffer["messages"] >= held) == (0, True)
        held = buffer["messages"]
    assert asked == sorted(set(asked)), "every change has said it anew"
    detector.switch("active")
    until(lambda: "start" in detector.events())


def test_a_bag_fills_the_buffers_before_anything_has_come(start: Start, tmp_path: Path, unused_port: int) -> None:
    """Of the topics and types of the settings, within the bounds; a rule looks at what comes, not at the bag."""
    begin = 1_795_250_000 * SECOND
    topics = [bag_topic(f"/vehicles/vehicle_0{number}/pose", POSE) for number in range(2)]
    topics += [bag_topic("/other", NUMBER), bag_topic("/vehicles/vehicle_02/pose", NUMBER)]
    bag = BagWriter(tmp_path / "bag", topics)
    for step in range(200):
        moment = begin + step * 100 * MS
        for number in range(2):
            bag.add(f"/vehicles/vehicle_0{number}/pose", moment, pose(moment, 100.0 * number))
        bag.add("/other", moment, b"\0\1\0\0" + struct.pack("<d", 1.0))
        bag.add("/vehicles/vehicle_02/pose", moment, b"\0\1\0\0" + struct.pack("<d", 1.0))
    bag.finish()
    settings = {**QUIET, "buffer": {"bag": str(tmp_path / "bag")}}
    detector = Detector(start, tmp_path, unused_port, settings)
    shown = detector.status()["topics"]
    assert {name: topic["buffer"]["messages"] for name, topic in shown.items()} == {
        topic.name: 101 for topic in topics[:2]
    }
    assert {topic["buffer"]["evicted_seconds"] for topic in shown.values()} == {99}
    assert (detector.events(), [topic["received"] for topic in shown.values()]) == ([], [0, 0])
    detector.process.terminate()
    _, log = detector.process.communicate(timeout=10)
    [filled] = [line for line in map(json.loads, log.splitlines()) if line["event"] == "filled"]
    assert (filled["bag"], filled["messages"]) == (str(tmp_path / "bag"), 400)


def test_a_bag_that_is_not_there_is_named_with_its_key(start: Start, tmp_path: Path, unused_port: int) -> None:
    (tmp_path / "config.yaml").write_text(write_mapping({**QUIET, "buffer": {"bag": str(tmp_path / "none")}}))
    paths = {"ROBOTKUBE_CONFIG": str(tmp_path / "config.yaml"), "ROBOTKUBE_HEALTH_PORT": str(unused_port)}
    process = start(*COMMAND, **paths)
    _, log = process.communicate(timeout=20)
    assert process.returncode == 2
    assert f"{tmp_path}/config.yaml: buffer.bag: {tmp_path}/none: is not there; name a" in log


def bag_topic(name: str, type_name: str) -> BagTopic:
    return BagTopic(name, type_name, "reliable", "volatile", 10)


def own_addresses() -> list[str]:
    """Addresses by which this machine is spoken to from elsewhere, as far as it has any; and one that stands for it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # nothing is sent: the kernel only chooses the way
        except OSError:
            return ["127.0.0.2"]
        return [str(probe.getsockname()[0]), "127.0.0.2"]


def test_commands_from_elsewhere_are_refused(start: Start, tmp_path: Path, unused_port: int) -> None:
    detector = Detector(start, tmp_path, unused_port, {**QUIET, "state": "inactive"})
    for nonsense in (b"[" * 7000, b"null", b'{"state": "activ"}'):
        connection = http.client.HTTPConnection("127.0.0.1", unused_port, timeout=5)
        connection.request("POST", "/state", nonsense)
        assert connection.getresponse().status == 400
        connection.close()
    for address in own_addresses():
        connection = http.client.HTTPConnection(address, unused_port, timeout=5, source_address=(address, 0))
        connection.request("POST", "/state", b'{"state": "active"}')
        answer = connection.getresponse()
        said = answer.read().decode()
        connection.close()
        assert (answer.status, said) == (
            403, "commands are accepted from within the pod only: kubectl exec or port-forward\n")  # fmt: skip
        connection.request("GET", "/status")
        assert connection.getresponse().status == 200
        connection.close()
    assert detector.status()["state"] == "inactive"
