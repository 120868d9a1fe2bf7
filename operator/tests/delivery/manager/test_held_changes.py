"""Holds of devices: read from Node and message, bounded, and exactly the changes on the device's agent wait."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.deployment.core.releases import Release, TaskCause
from robotkube.delivery.manager.core.held_changes import active_holds, held, waiting_tasks
from robotkube.delivery.manager.core.plans import Change
from robotkube.delivery.tasks.core.holds import HOLD_SECONDS_MAX, DeviceHold, message_hold, node_hold
from robotkube.errors import DocumentError

SECOND = 1_000_000_000
TEN = 1_795_255_200 * SECOND  # 2026-11-21T10:00:00Z
AGENTS = {"vehicle-00": "vehicle-00", "vehicle-01": "vehicle-01", "cloud-0": "cloud-0"}
DRIVING = DeviceHold("vehicle-00", TEN + 60 * SECOND, "driving")


def release(namespace: str, name: str = "recorder", task: str = "cloud-0/a", **values: Any) -> Release:
    cause = TaskCause(task, "event", "rule", "a" * 32, "recording")
    full = {**values, "placement": {"agent": namespace}}
    return Release(namespace, name, "event-detector", "1.0.0", f"sha256:{'0' * 64}", full, (cause,))


def added(release: Release) -> Change:
    return Change(release.path, None, release)


def removed(release: Release) -> Change:
    return Change(release.path, release, None)


def changed(before: Release, other: Release) -> Change:
    return Change(before.path, before, other)


def metadata(**annotations: str) -> dict[str, Any]:
    keys = {f"robotkube.io/{key.replace('_', '-')}": text for key, text in annotations.items()}
    fields = {"f:metadata": {"f:annotations": {f"f:{key}": {} for key in keys}}}
    other = {"time": "2026-11-21T12:00:00Z", "fieldsV1": {"f:status": {}}}
    written = {"time": "2026-11-21T10:00:00Z", "fieldsV1": fields}
    return {"annotations": keys, "creationTimestamp": "2026-11-01T10:00:00Z", "managedFields": [other, written]}


def test_a_node_says_why_and_until_when() -> None:
    read = node_hold("vehicle-00", metadata(hold="driving", hold_until="2026-11-21T10:01:00Z"))
    assert read == DRIVING
    assert read.text == "vehicle-00 holds changes until 2026-11-21T10:01:00Z: driving"


def test_a_node_that_says_nothing_holds_nothing() -> None:
    assert node_hold("vehicle-00", {}) is None
    assert node_hold("vehicle-00", metadata(hold_until="2026-11-21T10:01:00Z")) is None


def test_a_label_is_as_good_as_an_annotation() -> None:
    read = node_hold(
        "vehicle-00", {**metadata(hold_until="2026-11-21T10:01:00Z"), "labels": {"robotkube.io/hold": "busy"}}
    )
    assert read == DeviceHold("vehicle-00", TEN + 60 * SECOND, "busy")


@pytest.mark.parametrize("until", [None, "soon", "2027-01-01T00:00:00Z"])
def test_no_hold_lasts_longer_than_the_bound_after_it_was_reported(until: str | None) -> None:
    said = {"hold": "driving"} | ({"hold_until": until} if until else {})
    read = node_hold("vehicle-00", metadata(**said))
    assert read == DeviceHold("vehicle-00", TEN + HOLD_SECONDS_MAX * SECOND, "driving")


def test_without_the_servers_record_the_node_counts_from_its_creation() -> None:
    read = node_hold("v", {"labels": {"robotkube.io/hold": "x"}, "creationTimestamp": "2026-11-21T10:00:00Z"})
    assert read is not None
    assert read.until_ns == TEN + HOLD_SECONDS_MAX * SECOND


def test_a_message_says_the_same() -> None:
    assert message_hold("vehicle-00", b'{"reason": "driving", "until": "2026-11-21T10:01:00Z"}', TEN) == DRIVING
    assert message_hold("vehicle-00", b"", TEN) is None
    far = message_hold("vehicle-00", b'{"reason": "driving", "until": "2099-01-01T00:00:00Z"}', TEN)
    assert far is not None
    assert far.until_ns == TEN + HOLD_SECONDS_MAX * SECOND


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"driving", "must be a JSON object"),
        (b"[" * 4000, "must be a JSON object"),
        (b"x" * 5000, "5000 bytes, at most 4096"),
        (b"[]", "reason: must be text"),
        (b'{"reason": "driving"}', "until: must be an RFC 3339 time"),
        (b'{"reason": 1, "until": "2026-11-21T10:01:00Z"}', "reason: must be text"),
        (b"\xff", "must be a JSON object"),
    ],
)
def test_a_message_that_cannot_be_read_says_what_is_wrong(payload: bytes, words: str) -> None:
    with pytest.raises(DocumentError, match=words):
        message_hold("vehicle-00", payload, TEN)


def test_of_several_holds_of_an_agent_the_last_to_end_counts() -> None:
    later = DeviceHold("vehicle-00", TEN + 90 * SECOND, "loading")
    assert active_holds([later, DRIVING], TEN) == {"vehicle-00": later}
    assert active_holds([later, DRIVING], TEN + 90 * SECOND) == {}


def test_changes_on_the_agent_wait_the_others_go() -> None:
    new = added(release("vehicle-00", "new"))
    old = removed(release("vehicle-00", "old"))
    more = changed(release("vehicle-00", "more"), release("vehicle-00", "more", topics=2))
    elsewhere = added(release("cloud-0", "new", topics=1))
    going, waiting = held((new, more, elsewhere, old), [DRIVING], AGENTS, TEN)
    assert going == (elsewhere,)
    assert waiting == {change.path: DRIVING for change in (new, more, old)}


def test_they_go_on_when_the_hold_is_over() -> None:
    new = added(release("vehicle-00"))
    assert held((new,), [DRIVING], AGENTS, TEN + 60 * SECOND) == ((new,), {})
    assert held((new,), [], AGENTS, TEN) == ((new,), {})


def test_what_leaves_a_held_agent_does_not_start_elsewhere_meanwhile() -> None:
    leaves = removed(release("vehicle-00", size=1))
    arrives = added(release("vehicle-01", size=1))
    going, waiting = held((arrives, leaves), [DRIVING], AGENTS, TEN)
    assert going == ()
    assert waiting == {arrives.path: DRIVING, leaves.path: DRIVING}


def test_another_release_of_the_same_name_does() -> None:
    leaves = removed(release("vehicle-00", topics=["a"]))
    arrives = added(release("vehicle-01", topics=["b"]))
    going, _ = held((arrives, leaves), [DRIVING], AGENTS, TEN)
    assert going == (arrives,)


def test_waiting_tasks_have_what_they_wait_for() -> None:
    changes = (added(release("vehicle-00")), removed(release("vehicle-00", "old", task="cloud-0/b")))
    _, waiting = held(changes, [DRIVING], AGENTS, TEN)
    texts = waiting_tasks(changes, waiting)
    assert texts["cloud-0/a"] == f"vehicle-00/recorder: {DRIVING.text}"
    assert texts["cloud-0/b"] == f"vehicle-00/old: {DRIVING.text}"


def test_a_task_that_is_answered_already_waits_for_nothing() -> None:
    before = release("vehicle-00", "mqtt-bridge", topics=1)
    other = TaskCause("cloud-0/b", "event", "rule", "a" * 32, "recording")
    after = Release(before.namespace, before.name, before.chart, before.version, before.digest, {"topics": 2})
    change = changed(before, replace(after, causes=(*before.causes, other)))
    _, waiting = held((change,), [DRIVING], AGENTS, TEN)
    assert set(waiting_tasks((change,), waiting)) == {"cloud-0/b"}
