"""The detector's process: real ROS topics in, calls to an API server out."""

from __future__ import annotations

import json
import signal
import subprocess
import threading
import time
import urllib.error
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from robotkube.foundation.documents.core.yaml_codec import write_mapping
from tests.stages.detector.process import PUBLISHER, SECONDS_MAX, Api, is_up, move, read
from tests.stages.detector.proximity_settings import SETTINGS
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

NEAR, FAR = 100.0, 800.0


class Receiver(ThreadingHTTPServer):
    """Takes webhooks when it is told to."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), HookHandler)
        self.taking = False
        self.refused: list[str] = []
        self.taken: list[str] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/hook"

    @property
    def told(self) -> list[str]:
        """What was taken, each once: what a killed process was saying may come again."""
        return list(dict.fromkeys(self.taken))


class HookHandler(BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        heard = self.server.taken if self.server.taking else self.server.refused
        heard.append(self.headers["X-Robotkube-Delivery"])
        self.send_response(204 if self.server.taking else 503)
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        return None


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    receiver = Receiver()
    thread = threading.Thread(target=receiver.serve_forever, args=(0.02,))
    thread.start()
    yield receiver
    receiver.shutdown()
    receiver.server_close()
    thread.join(SECONDS_MAX)


@dataclass(frozen=True)
class Pages:
    """What a detector says at its port."""

    port: int

    def text(self, path: str) -> str:
        return read(self.port, path)

    def page(self, path: str) -> Any:
        return json.loads(self.text(path))

    def events(self) -> Any:
        return self.page("/events")["events"]

    def counts(self) -> list[int]:
        """The poses of one vehicle in each second."""
        counted = self.page("/input")["topics"]["/vehicles/vehicle_00/pose"]
        arrived = [count for _, count in counted["seconds"]]
        assert sum(arrived) == counted["received"]
        return arrived

    def steady(self) -> bool:
        """100 Hz, and so many that the seconds in which one stalled do not count."""
        whole = self.counts()[1:-1]
        return sum(whole) > 200 and 90 * len(whole) <= sum(whole) <= 110 * len(whole)


def test_live_poses_become_tasks_until_the_rule_changes(
    api: Api, start: Callable[..., subprocess.Popen[str]], tmp_path: Path, unused_port: int
) -> None:
    topics = [{**SETTINGS["topics"][0], "buffer": {"seconds": 60}}]
    api.settings = write_mapping({**SETTINGS, "topics": topics})
    (tmp_path / "config.yaml").write_text(api.settings)
    detector = start(
        "-m", "robotkube.robots.detector",
        ROBOTKUBE_API_SERVER=f"http://127.0.0.1:{api.server_port}",
        ROBOTKUBE_CONFIG=str(tmp_path / "config.yaml"),
        ROBOTKUBE_CONFIGMAP="cloud-0/event-detector",
        ROBOTKUBE_HEALTH_PORT=str(unused_port),
    )  # fmt: skip

    pages = Pages(unused_port)
    move(tmp_path, NEAR)
    start(*PUBLISHER, str(tmp_path), "60")
    until(lambda: is_up(unused_port))
    for number, metres in enumerate((NEAR, FAR, NEAR), 1):
        move(tmp_path, metres)
        until(lambda number=number: len(pages.events()) == number and pages.events()[-1]["done"])
    assert [call for call, _ in api.calls] == ["create", "delete", "create"]
    assert api.calls[0] == ("create", api.calls[1][1])
    assert [event["edge"] for event in pages.events()] == ["start", "stop", "start"]
    assert pages.events()[0]["task"] == f"cloud-0/{api.calls[0][1]}"
    assert all(event["stamp"] <= event["time"] <= event["done"] <= time.time_ns() for event in pages.events())
    until(pages.steady)

    # refused settings leave the old ones at work, and the buffers as they are
    before = pages.page("/status")["topics"]["/vehicles/vehicle_00/pose"]["buffer"]["messages"]
    wrong = {**SETTINGS, "topics": topics, "rules": [{**SETTINGS["rules"][0], "stop_distance_m": 1}]}
    api.settings = write_mapping(wrong)
    api.changed.set()
    until(lambda: api.warnings)
    status = pages.page("/status")
    expected = "config.yaml: rules[0].stop_distance_m: must not be less than start_distance_m"
    assert status["settings"]["refused"].startswith(expected)
    assert status["rules"]["names"] == ["near"]
    [warning] = api.warnings
    assert (warning["type"], warning["reason"]) == ("Warning", "SettingsRefused")
    assert warning["regarding"]["name"] == "event-detector"
    assert warning["note"].startswith(expected)
    assert "robotkube_detector_settings_refused 1" in pages.text("/metrics")
    with pytest.raises(urllib.error.HTTPError, match="503"):
        pages.text("/readyz")
    assert status["not_ready"].startswith(f"the newest settings are refused, the ones before are at work: {expected}")

    # vehicle-01 is near now; without the rule its task goes
    assert api.objects
    api.settings = write_mapping({"name": SETTINGS["name"], "topics": topics})
    api.changed.set()
    until(lambda: not api.objects)
    until(lambda: pages.page("/status")["topics"]["/vehicles/vehicle_00/pose"]["buffer"]["messages"] > before)
    status = pages.page("/status")
    assert (status["settings"]["refused"], status["rules"]["names"]) == ("", [])
    assert pages.text("/readyz") == "ok\n"
    assert status["topics"]["/vehicles/vehicle_00/pose"]["buffer"]["cleared"] == 0
    detector.send_signal(signal.SIGTERM)
    assert detector.wait(8.0) == 0


def test_a_killed_detector_owes_nobody_an_edge(
    api: Api, receiver: Receiver, start: Callable[..., subprocess.Popen[str]], tmp_path: Path, unused_port: int
) -> None:
    """What the receiver had not taken it gets from the next process, with the same ids; the task goes on."""
    hook = {"rule": "near", "kind": "webhook", "url": receiver.url}
    api.settings = write_mapping({**SETTINGS, "reactions": [*SETTINGS["reactions"], hook]})
    (tmp_path / "config.yaml").write_text(api.settings)

    def detector() -> subprocess.Popen[str]:
        return start(
            "-m", "robotkube.robots.detector",
            ROBOTKUBE_API_SERVER=f"http://127.0.0.1:{api.server_port}",
            ROBOTKUBE_CONFIG=str(tmp_path / "config.yaml"),
            ROBOTKUBE_CONFIGMAP="cloud-0/event-detector",
            ROBOTKUBE_HEALTH_PORT=str(unused_port),
            ROBOTKUBE_REACTIONS=str(tmp_path / "reactions"),
        )  # fmt: skip

    def raised() -> list[str]:
        events = json.loads(read(unused_port, "/events"))["events"]
        return [f"{event['id']}-{event['edge']}" for event in events]

    def kept() -> int:
        return int(json.loads(read(unused_port, "/status"))["reactions_journal"]["kept"])

    first = detector()
    move(tmp_path, NEAR)
    start(*PUBLISHER, str(tmp_path), "60")
    until(lambda: is_up(unused_port))
    for number, metres in enumerate((NEAR, FAR, NEAR), 1):
        move(tmp_path, metres)
        until(lambda number=number: len(raised()) == number)
    until(lambda: len(api.calls) == 3 and receiver.refused)
    until(lambda: kept() == 3)
    owed = raised()
    calls = list(api.calls)
    first.kill()
    first.wait(SECONDS_MAX)
    assert receiver.taken == []
    receiver.taking = True
    detector()
    until(lambda: is_up(unused_port))
    until(lambda: len(receiver.told) >= len(owed))
    assert receiver.told == owed
    until(lambda: kept() == 0)

    # the event that lasted goes on, and ends as what it was
    [task] = api.objects
    move(tmp_path, FAR)
    until(lambda: len(receiver.told) > len(owed))
    assert receiver.told[len(owed)] == owed[-1].replace("start", "stop")
    until(lambda: len(api.calls) > len(calls))
    assert api.calls[: len(calls) + 1] == [*calls, ("delete", task)]


def test_wrong_settings_are_refused_with_file_key_and_fix(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(write_mapping({**SETTINGS, "rules": [{**SETTINGS["rules"][0], "stop_distance_m": 1}]}))
    process = start("-m", "robotkube.robots.detector", ROBOTKUBE_CONFIG=str(path), ROBOTKUBE_HEALTH_PORT="0")
    _, text = process.communicate(timeout=SECONDS_MAX)
    assert process.returncode == 2
    error = json.loads(text.splitlines()[-1])["error"]
    assert error.startswith(f"{path}: rules[0].stop_distance_m: must not be less than start_distance_m")


def test_a_detector_that_rests_is_ready_within_a_tenth_of_a_second(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path, unused_port: int
) -> None:
    """From the command to the first messages in the buffers, beside a publisher at full rate."""
    (tmp_path / "config.yaml").write_text(write_mapping({**SETTINGS, "reactions": [], "state": "inactive"}))
    start(
        "-m", "robotkube.robots.detector",
        ROBOTKUBE_CONFIG=str(tmp_path / "config.yaml"),
        ROBOTKUBE_HEALTH_PORT=str(unused_port),
    )  # fmt: skip
    start(*PUBLISHER, str(tmp_path), "60")

    def status() -> Any:
        return json.loads(read(unused_port, "/status"))

    until(lambda: is_up(unused_port))
    assert (status()["state"], status()["topics"], status()["not_ready"]) == ("inactive", {}, "")
    with pytest.raises(urllib.error.HTTPError, match="400") as refused:
        read(unused_port, "/state", b'{"state": "asleep"}')
    refused.value.close()
    assert json.loads(read(unused_port, "/state", b'{"state": "active"}')) == {"state": "active"}
    until(lambda: len(status()["topics"]) == 2)
    until(lambda: status()["rules"]["names"] == ["near"])
    until(lambda: all(topic["received"] > 0 for topic in status()["topics"].values()))
    assert read(unused_port, "/readyz") == "ok\n"
