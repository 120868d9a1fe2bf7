"""Reports of a bridge about topics that it does not carry: when they are sent, and what is read of them."""

from __future__ import annotations

import json
from typing import Any

import pytest

from robotkube.errors import DocumentError
from robotkube.robots.bridge.core.link_reports import (
    LINKS_MAX,
    PAYLOAD_BYTES_MAX,
    LinkFault,
    LinkReport,
    read_report,
    report_document,
    report_release,
)
from robotkube.robots.bridge.loops.link_reporting import LinkReporting
from robotkube.robots.mqtt.core.batches import encode_batch
from tests.stages.bridge.in_memory import CLOUD, EVERYBODY, POSE, BridgeStage

TOPIC = "robotkube/links/vehicle-00/mqtt-bridge"
RELEASE = "vehicle-00/mqtt-bridge"
ODD = {**CLOUD, "type": "nowhere/msg/Cloud"}


class Reporter(BridgeStage):
    """A bridge that reports, and the reports that the broker got."""

    def __init__(self) -> None:
        super().__init__(LinkReporting("mqtt-bridge", "mqtt-bridge-1", 7))
        self.seconds = 0.0

    def said(self) -> list[LinkReport | None]:
        """The reports of the next two seconds."""
        telemetry = self.channels["telemetry"]
        before = len(telemetry.sent)
        for _ in range(2):
            self.seconds += 1.0
            self.bridge.turn(self.seconds)
        sent = telemetry.sent[before:]
        assert all(retained for topic, _, retained in sent if topic == TOPIC)
        return [read_report(RELEASE, payload, len(payload)) for topic, payload, _ in sent if topic == TOPIC]


def faults(report: LinkReport | None) -> dict[tuple[str, str], str]:
    assert report is not None
    assert (report.release, report.pod, report.started_ns) == (RELEASE, "mqtt-bridge-1", 7)
    return {(fault.direction, fault.topic): fault.reason for fault in report.faults}


def test_while_everything_is_carried_nothing_is_said() -> None:
    reporter = Reporter()
    reporter.configure(out=[POSE], into=[EVERYBODY])
    reporter.connect()
    assert reporter.said() == []


def test_a_type_that_is_not_installed_is_reported_once_and_taken_back_with_the_topic() -> None:
    reporter = Reporter()
    reporter.configure(out=[ODD, POSE])
    reporter.connect()
    [report] = reporter.said()
    [(place, reason)] = faults(report).items()
    assert place == ("out", CLOUD["name"])
    assert "message package nowhere is not installed" in reason
    assert reporter.said() == []
    reporter.configure(out=[POSE])
    assert reporter.said() == [None]
    assert reporter.said() == []


def test_what_the_broker_refuses_is_reported_by_the_topics_own_name() -> None:
    reporter = Reporter()
    reporter.configure(out=[POSE], into=[{**POSE, "name": "/other"}, EVERYBODY])
    reporter.connect()
    reporter.said()
    events = reporter.channels["telemetry"].events
    for refused in ("mqtt/other", "mqtt/vehicles/+/pose", TOPIC):
        events.refused(refused, "not authorised")
    [report] = reporter.said()
    assert faults(report) == {
        ("in", "/other"): "the broker refuses mqtt/other: not authorised",
        ("in", "/vehicles/{agent}/pose"): "the broker refuses mqtt/vehicles/+/pose: not authorised",
    }


def test_a_topic_of_an_agent_that_cannot_be_opened_is_reported_for_the_one_that_stands_for_all() -> None:
    reporter = Reporter()
    reporter.configure(into=[{**EVERYBODY, "type": "nowhere/msg/Odd"}])
    reporter.connect()
    received = reporter.channels["telemetry"].events.received
    received("mqtt/vehicles/vehicle_07/pose", encode_batch(1, 0, [b"pose"]), b"")
    [report] = reporter.said()
    [(place, reason)] = faults(report).items()
    assert place == ("in", "/vehicles/{agent}/pose")
    assert "/vehicles/vehicle_07/pose is not carried" in reason


def test_reports_are_about_releases_of_known_agents() -> None:
    namespaces = {"vehicle-00": "fleet-vehicle-00"}
    assert report_release(namespaces, TOPIC) == "fleet-vehicle-00/mqtt-bridge"
    for topic in ("vehicle-01/mqtt-bridge", "vehicle-00", "vehicle-00/", "vehicle-00/A", "vehicle-00/a/b"):
        assert report_release(namespaces, f"robotkube/links/{topic}") == ""


GOOD = dict(report_document("pod-1", 5, [LinkFault("out", "/x", "why")]))
FAULT = GOOD["notCarried"][0]


@pytest.mark.parametrize(
    ("document", "problem"),
    [
        ([], "must be a mapping"),
        ({**GOOD, "more": 1}, "more: unknown key"),
        ({"pod": "pod-1", "started": "5"}, "notCarried: missing"),
        ({**GOOD, "started": 5}, "started: 5 must match"),
        ({**GOOD, "pod": "../x"}, "pod: "),
        ({**GOOD, "notCarried": [{**FAULT, "direction": "up"}]}, "notCarried[0].direction: "),
        ({**GOOD, "notCarried": [{**FAULT, "topic": "x y"}]}, "notCarried[0].topic: "),
        ({**GOOD, "notCarried": [{**FAULT, "reason": 1}]}, "notCarried[0].reason: must be text"),
        ({**GOOD, "notCarried": [FAULT] * (LINKS_MAX + 1)}, f"at most {LINKS_MAX} are read"),
    ],
)
def test_a_report_is_read_strictly(document: Any, problem: str) -> None:
    payload = json.dumps(document).encode()
    with pytest.raises(DocumentError) as refused:
        read_report(RELEASE, payload, len(payload))
    assert problem in str(refused.value)


def test_what_is_no_report_is_refused_in_words() -> None:
    for payload, size in ((b"{", 1), (b"\xff", 1), (b"", PAYLOAD_BYTES_MAX + 1)):
        with pytest.raises(DocumentError):
            read_report(RELEASE, payload, size)
    assert read_report(RELEASE, b"", 0) is None
