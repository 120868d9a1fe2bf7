"""What is said of the components of an installation while their pods come up, and when they do not."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Sequence
from typing import Any

import pytest

from ci.component_lines import SILENT_SECONDS_MAX, ComponentLines, documents
from ci.installation import what_hangs
from tests.stages.kubernetes.component_pods import pod


class Stage:
    """Lines, with a clock that stands still."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.now = 100.0
        self.warnings: dict[str, str] = {}
        self.lines = ComponentLines(self.said.append, self.events, lambda: self.now)

    def events(self, namespace: str, name: str) -> Sequence[Any]:
        message = self.warnings.get(f"{namespace}/{name}")
        return [{"type": "Warning", "reason": "Failed", "message": message}] if message else []


def test_a_component_is_ready_when_all_its_pods_are() -> None:
    stage = Stage()
    for one in (pod("broker-0"), pod("manager-a"), pod("manager-b")):
        stage.lines.saw("ADDED", one)
    stage.now = 103.25
    stage.lines.saw("MODIFIED", pod("manager-a", ready=True))
    assert stage.said == []
    stage.lines.saw("MODIFIED", pod("broker-0", ready=True))
    stage.now = 104.0
    stage.lines.saw("MODIFIED", pod("manager-b", ready=True))
    assert stage.said == ["broker: ready after 3.2 s", "manager: ready after 4.0 s"]
    assert stage.lines.hanging() == ()


def test_of_an_upgrade_only_what_changes_is_told() -> None:
    """The new pod comes while the old one serves; that goes afterwards."""
    stage = Stage()
    for one in (pod("broker-0", ready=True), pod("manager-a", ready=True)):
        stage.lines.saw("ADDED", one)
    stage.lines.saw("ADDED", pod("manager-b", phase="Pending"))
    stage.lines.saw("MODIFIED", pod("manager-b", ready=True))
    going = pod("manager-a", ready=True)
    going["metadata"]["deletionTimestamp"] = "2026-11-27T10:00:00Z"
    stage.lines.saw("MODIFIED", going)
    stage.lines.saw("DELETED", pod("manager-a"))
    assert stage.said == ["manager: ready after 0.0 s"]


def test_a_pod_that_is_replaced_before_it_was_ready_is_forgotten() -> None:
    stage = Stage()
    stage.lines.saw("ADDED", pod("manager-a"))
    stage.lines.saw("DELETED", pod("manager-a"))
    assert (stage.said, stage.lines.hanging()) == ([], ())
    stage.lines.saw("ADDED", pod("manager-b", ready=True))
    assert stage.said == ["manager: ready after 0.0 s"]


def test_a_job_is_done() -> None:
    stage = Stage()
    for seconds, seen in ((0, pod("bootstrap-x", phase="Pending")), (8, pod("bootstrap-x", ready=True))):
        seen["metadata"]["ownerReferences"] = [{"kind": "Job"}]
        stage.now += seconds
        stage.lines.saw("MODIFIED", seen)
    assert stage.lines.hanging() == ("bootstrap is not ready: pod bootstrap-x: Running",)
    stage.now += 4
    stage.lines.saw("MODIFIED", pod("bootstrap-x", phase="Succeeded"))
    assert stage.said == ["bootstrap: done after 12.0 s"]


def test_what_hangs_is_said_with_its_events_once_for_each_reason() -> None:
    stage = Stage()
    waits = {"waiting": {"reason": "ImagePullBackOff", "message": "no such image"}}
    hanging = pod("forge-0", phase="Pending", containerStatuses=[{"name": "gitea", "ready": False, "state": waits}])
    stage.lines.saw("ADDED", hanging)
    stage.warnings["robotkube/forge-0"] = "Failed to pull image"
    stage.lines.look()
    assert stage.said == []
    expected = (
        "forge is not ready: pod forge-0: container gitea waits: ImagePullBackOff: no such image; "
        "event Failed: Failed to pull image"
    )
    for _ in range(3):
        stage.now += SILENT_SECONDS_MAX
        stage.lines.look()
    assert stage.said == [expected]
    stage.warnings["robotkube/forge-0"] = "Back-off"
    stage.now += SILENT_SECONDS_MAX
    stage.lines.look()
    assert stage.said == [expected, expected.replace("Failed to pull image", "Back-off")]


def test_nothing_is_said_to_hang_while_others_become_ready() -> None:
    stage = Stage()
    stage.lines.saw("ADDED", pod("forge-0"))
    for number in range(3):
        stage.now += SILENT_SECONDS_MAX - 1
        stage.lines.saw("ADDED", pod(f"c{number}-0"))
        stage.lines.saw("MODIFIED", pod(f"c{number}-0", ready=True))
        stage.lines.look()
    assert [line for line in stage.said if "not ready" in line] == []


@pytest.mark.parametrize(
    ("hanging", "said"),
    [
        (
            ["forge is not ready: a", "gate is not ready: b"],
            "helm: failed: forge is not ready: a\ngate is not ready: b",
        ),
        ([], "helm: failed: timed out waiting for the condition"),
    ],
)
def test_the_words_for_having_waited_name_what_hangs(hanging: list[str], said: str) -> None:
    assert what_hangs("helm: failed: timed out waiting for the condition", hanging) == said
    assert what_hangs("helm: no such chart", hanging) == "helm: no such chart"


def test_documents_come_when_they_are_whole() -> None:
    reading, writing = os.pipe()
    found: list[Any] = []
    with os.fdopen(reading, "rb") as stream:
        thread = threading.Thread(target=lambda: found.extend(documents(stream)))
        thread.start()
        text = json.dumps({"a": "é"}, ensure_ascii=False).encode()
        for part in (text + b"\n" + text[:7], text[7:], b"\n\n" + text):
            os.write(writing, part)
        os.close(writing)
        thread.join()
    assert found == [{"a": "é"}] * 3
