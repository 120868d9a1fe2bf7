"""Reactions that tell somebody: signed webhooks, installed reactions, MQTT; retries, order, bounds and dead letters."""

from __future__ import annotations

import hashlib
import hmac
import json
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.robots.detector.adapters import otlp_spans as traces_otlp
from robotkube.robots.detector.adapters.otlp_spans import OtlpSpans
from robotkube.robots.detector.core.settings import read_detector_settings
from robotkube.robots.reactions.adapters.child_processes import ProcessSender
from robotkube.robots.reactions.adapters.webhook_sender import WebhookSender
from robotkube.robots.reactions.core.notifications import delivery_id, notification
from robotkube.robots.reactions.loops import deliveries as module
from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
from robotkube.robots.reactions.loops.deliveries import QUEUE_MAX, Deliveries
from robotkube.robots.reactions.ports.deliveries import DeliverySender, EdgeDelivery
from robotkube.robots.rules.core import START, Cause, Edge
from tests.stages.detector.in_memory import DetectorStage, MemoryTasks
from tests.stages.detector.process import kept_port
from tests.stages.detector.proximity_settings import SETTINGS
from tests.stages.waiting import WAIT_SECONDS_MAX, until

SECRET = b"shared"
EDGE = Edge(
    "near", START, ("a", "b"), "1" * 16, "2" * 32, 20, 10, 1.5, (Cause("/a", 10, {"x": 1.0}),), {"distance_m": 1.5}
)


class Receiver(ThreadingHTTPServer):
    """Keeps what is posted; answers with `statuses`, then 204."""

    def __init__(self, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), Handler)
        self.statuses: list[int] = []
        self.posted: list[tuple[dict[str, str], bytes]] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/hook"


class Handler(BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.posted.append(({key.lower(): value for key, value in self.headers.items()}, body))
        self.send_response(self.server.statuses.pop(0) if self.server.statuses else 204)
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        return None


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    server = Receiver()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join(10)


@pytest.fixture
def box() -> DeadLetterBox:
    return DeadLetterBox(lambda: 7)


@pytest.fixture
def make(box: DeadLetterBox) -> Iterator[Callable[..., Deliveries]]:
    made: list[Deliveries] = []

    def make(sender: DeliverySender, retry_seconds: float = 60.0) -> Deliveries:
        made.append(Deliveries("told", sender, retry_seconds, box, time.monotonic))
        made[-1].start()
        return made[-1]

    yield make
    for one in made:
        one.stop(2.0)


def delivery(number: int = 0) -> EdgeDelivery:
    return EdgeDelivery(f"{number:016x}-start", START, EDGE.trace, notification(EDGE, "cloud-0/d", "{agents} are near"))


class Script:
    """A sender that does what it is told: None, or an error to raise."""

    def __init__(self, *outcomes: Exception | None) -> None:
        self.outcomes = list(outcomes)
        self.sent = list[str]()
        self.closed = False
        self.going = threading.Event()
        self.going.set()

    def probe(self) -> None: ...

    def send(self, delivery: EdgeDelivery) -> None:
        assert self.going.wait(WAIT_SECONDS_MAX)
        self.sent.append(delivery.id)
        if self.outcomes and (error := self.outcomes.pop(0)) is not None:
            raise error

    def close(self) -> None:
        self.closed = True


def test_a_notification_says_everything() -> None:
    document = json.loads(notification(EDGE, "cloud-0/d", "{agents} are near"))
    assert document["id"] == delivery_id(EDGE) == f"{'1' * 16}-start"
    assert (document["event"], document["edge"], document["rule"], document["agents"]) == (
        "1" * 16,
        "start",
        "near",
        ["a", "b"],
    )
    assert (document["time"], document["stamp"], document["trace"], document["distance_m"]) == (20, 10, "2" * 32, 1.5)
    assert (document["detector"], document["reason"]) == ("cloud-0/d", "a, b are near")
    assert document["causes"] == [{"topic": "/a", "stamp": 10, "values": {"x": 1.0}}]


def test_webhooks_are_signed_and_tried_again(receiver: Receiver, make: Callable[..., Deliveries]) -> None:
    receiver.statuses = [503, 429]
    deliveries = make(WebhookSender(receiver.url, lambda: SECRET, 5.0))
    deliveries.react(delivery())
    until(lambda: deliveries.counts() == {"delivered": 1, "retries": 2, "dead": 0, "waiting": 0})
    assert len(receiver.posted) == 3
    headers, body = receiver.posted[0]
    assert receiver.posted[2] == receiver.posted[0], "a repetition is the same to the letter"
    assert headers["x-hub-signature-256"] == f"sha256={hmac.new(SECRET, body, hashlib.sha256).hexdigest()}"
    assert headers["x-robotkube-delivery"] == delivery().id
    assert headers["x-robotkube-event"] == "start"
    assert headers["traceparent"].split("-")[1] == EDGE.trace
    assert body == delivery().body


@pytest.mark.parametrize("status", [400, 404, 302])
def test_a_refused_webhook_is_a_dead_letter(
    receiver: Receiver, make: Callable[..., Deliveries], box: DeadLetterBox, status: int
) -> None:
    receiver.statuses = [status]
    deliveries = make(WebhookSender(receiver.url, None, 5.0))
    deliveries.react(delivery(1))
    deliveries.react(delivery(2))
    until(lambda: deliveries.counts()["delivered"] == 1)
    assert deliveries.counts()["dead"] == 1
    [letter] = box.documents()
    assert (letter["reaction"], letter["id"], letter["time"]) == ("told", delivery(1).id, 7)
    assert f"answered {status}" in letter["reason"]
    assert "x-hub-signature-256" not in receiver.posted[0][0]


def test_a_receiver_that_is_away_is_named_until_it_is_there(make: Callable[..., Deliveries]) -> None:
    with kept_port() as port:
        deliveries = make(WebhookSender(f"http://127.0.0.1:{port}/", None, 1.0))
        until(lambda: "does not answer" in deliveries.unreachable)


def test_a_name_that_can_be_no_hosts_is_a_receiver_that_is_away(make: Callable[..., Deliveries]) -> None:
    deliveries = make(WebhookSender("http://a..b/", None, 1.0), 0.1)
    until(lambda: "does not answer" in deliveries.unreachable)
    deliveries.react(delivery())
    until(lambda: deliveries.counts()["dead"] == 1)


def test_a_detector_is_ready_while_its_receiver_is_there(
    make: Callable[..., Deliveries], unused_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also when there is nothing to say to it: away, back, and the page and the metric with it."""
    monkeypatch.setattr(module, "PROBE_SECONDS", 0.1)
    server = Receiver(unused_port)
    port = unused_port
    stage = DetectorStage(MemoryTasks())
    hook = {"rule": "near", "kind": "webhook", "url": f"http://127.0.0.1:{port}/"}
    document = {**SETTINGS, "reactions": [hook]}
    [settings] = read_detector_settings(document, "config.yaml").deliveries
    stage.reactions[settings.name] = make(WebhookSender(hook["url"], None, 1.0))
    stage.apply(document)
    until(lambda: stage.status.not_ready() == "")
    server.server_close()
    until(lambda: "does not answer" in stage.status.not_ready())
    assert "robotkube_detector_ready 0" in stage.status.metrics()
    server = Receiver(port)
    until(lambda: stage.status.not_ready() == "")
    assert "robotkube_detector_ready 1" in stage.status.metrics()
    server.server_close()


def test_order_is_kept_and_who_waits_too_long_is_given_up(make: Callable[..., Deliveries], box: DeadLetterBox) -> None:
    away = UnavailableError("away")
    sender = Script(away, away, None, InputError("no"), None)
    deliveries = make(sender)
    for number in range(3):
        deliveries.react(delivery(number))
    until(lambda: deliveries.counts()["delivered"] == 2)
    first, second, third = (delivery(number).id for number in range(3))
    assert sender.sent == [first, first, first, second, third]
    impatient = make(Script(*[away] * 100), retry_seconds=0.3)
    impatient.react(delivery(9))
    until(lambda: impatient.counts()["dead"] == 1)
    assert [letter["reason"] for letter in box.documents()] == ["no", "away"]


def test_what_is_counted_as_given_up_is_in_the_box_already() -> None:
    counted: list[int] = []

    def clock_ns() -> int:
        counted.append(deliveries.counts()["dead"])
        return 7

    deliveries = Deliveries("told", Script(InputError("no")), 60.0, DeadLetterBox(clock_ns), time.monotonic)
    deliveries.start()
    deliveries.react(delivery())
    until(lambda: deliveries.counts()["dead"] == 1)
    deliveries.stop(5.0)
    assert counted == [0]


def test_a_full_queue_and_the_end_lose_nothing_in_silence(make: Callable[..., Deliveries], box: DeadLetterBox) -> None:
    sender = Script(*[UnavailableError("away")] * 1000)
    sender.going.clear()
    deliveries = make(sender)
    for number in range(QUEUE_MAX + 10):
        deliveries.react(delivery(number))
    assert sender.sent == [], "who reacts never waits: the sender has not answered once by then"
    assert deliveries.counts()["dead"] in (9, 10)
    sender.going.set()
    assert not deliveries.stop(0.5)
    until(lambda: deliveries.counts()["dead"] == QUEUE_MAX + 10)
    assert box.documents()[-1]["reason"] in ("the detector ended", "away")


def test_what_waits_is_delivered_at_the_end(make: Callable[..., Deliveries]) -> None:
    sender = Script()
    deliveries = make(sender)
    for number in range(50):
        deliveries.react(delivery(number))
    assert deliveries.stop(5.0)
    assert len(sender.sent) == 50
    assert sender.closed


REACTION = """
import os, sys, time
from pathlib import Path
from robotkube.robots.reactions.adapters.child_processes import serve

def load(plugin, settings):
    def react(event):
        print("to the log", event["id"])
        with open(settings["file"], "a") as file:
            file.write(event["id"] + "\\n")
        lines = open(settings["file"]).read().split()
        what = settings["does"][len(lines) - 1]
        if what == "fail": raise OSError("not now")
        if what == "refuse": raise ValueError("never")
        if what == "sleep":
            Path(settings["asleep"]).touch()
            time.sleep(60)
        if what == "die": os._exit(3)
    return react

serve(load)
"""


LOADS_NOTHING = """
import time
from robotkube.robots.reactions.adapters.child_processes import serve

def load(plugin, settings):
    raise OSError("it is not here")

serve(load)
time.sleep(60)
"""


class Sleeper(ProcessSender):
    """Its bound counts from the moment at which the reaction falls asleep: whoever is only slow has time."""

    asleep: Path

    def _answer(self, seconds: float) -> bytes:
        assert self._process is not None
        answers = self._process.stdout
        until(lambda: self.asleep.exists() or select.select([answers], [], [], 0)[0])
        try:
            return super()._answer(seconds)
        finally:
            self.asleep.unlink(missing_ok=True)


def test_an_installed_reaction_fails_hangs_and_dies_alone(
    make: Callable[..., Deliveries], box: DeadLetterBox, tmp_path: Path
) -> None:
    script, written = tmp_path / "host.py", tmp_path / "told"
    script.write_text(REACTION)
    does = ["fail", "sleep", "die", "well", "refuse", "well"]
    settings = {"file": str(written), "asleep": str(tmp_path / "asleep"), "does": does}
    sender = Sleeper("whisper", settings, 0.5, [sys.executable, str(script)])
    sender.asleep = tmp_path / "asleep"
    deliveries = make(sender)
    for number in range(3):
        deliveries.react(delivery(number))
    until(lambda: deliveries.counts()["delivered"] == 2)
    assert deliveries.counts()["retries"] == 3
    assert [line[-7] for line in written.read_text().split()] == ["1"] * 6, (
        "the document of the edge, each time the same"
    )
    assert [letter["reason"] for letter in box.documents()] == ["whisper: ValueError: never"]
    assert deliveries.stop(5.0)


def test_a_process_that_has_not_loaded_its_reaction_is_not_taken_for_one_that_has(tmp_path: Path) -> None:
    """It takes its time to end."""
    script = tmp_path / "host.py"
    script.write_text(LOADS_NOTHING)
    sender = ProcessSender("whisper", {}, 5.0, [sys.executable, str(script)])
    for _ in range(2):
        with pytest.raises(UnavailableError, match="OSError: it is not here"):
            sender.probe()
    sender.close()


def test_a_reaction_that_nobody_has_installed_is_named(make: Callable[..., Deliveries]) -> None:
    deliveries = make(ProcessSender("whisper", {}, 5.0))
    until(lambda: "no installed package offers the reaction whisper" in deliveries.unreachable)


def test_spans_go_to_the_collector(receiver: Receiver, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        traces_otlp, "END_SECONDS_MAX", WAIT_SECONDS_MAX
    )  # what waits is sent, however slow the machine
    spans = OtlpSpans(receiver.url, "robotkube-event-detector", "cloud-0/d")
    spans.span("2" * 32, "event", 10, 20, {"robotkube.rule": "near"})
    spans.close()
    [(headers, body)] = receiver.posted
    assert headers["content-type"] == "application/json"
    [scope] = json.loads(body)["resourceSpans"][0]["scopeSpans"]
    [span] = scope["spans"]
    assert (span["traceId"], span["name"]) == ("2" * 32, "event")
    assert (span["startTimeUnixNano"], span["endTimeUnixNano"]) == ("10", "20")
    assert span["attributes"] == [{"key": "robotkube.rule", "value": {"stringValue": "near"}}]


def test_the_end_is_heard_while_nothing_is_to_do(
    make: Callable[..., Deliveries], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "WAIT_SECONDS", 600)
    sender = Script(None)
    deliveries = make(sender)
    until(lambda: not deliveries.unreachable, "the receiver found")
    assert deliveries.stop(WAIT_SECONDS_MAX)
    assert sender.closed
    assert deliveries.counts()["waiting"] == 0
