"""Commit messages: built and read back equal; forged or incomplete ones are refused."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.commit_messages import CommitMessage, one_line, read_message, write_message
from robotkube.delivery.deployment.core.releases import TaskCause
from robotkube.errors import DocumentError
from robotkube.registry.charts.core.references import ChartReference

PLAN = "20261121-100000-1a2b3c"
CAUSES = (TaskCause("cloud-0/a", "e1", "near", "1" * 32, ""), TaskCause("cloud-0/b", "e2", "near", "2" * 32, ""))
CHART = ChartReference("mqtt-bridge", "0.1.0", "sha256:" + "a" * 64)
OTHER = ChartReference("event-detector", "0.2.0", "sha256:" + "b" * 64)
SUMMARY = "sha256:" + "c" * 64
REASON = "vehicle-00, vehicle-01 within 400 m"
MESSAGE = CommitMessage("deploy", "recording", REASON, PLAN, CAUSES, (), (CHART,), (SUMMARY,), "manager", 7)


@pytest.mark.parametrize(
    "message",
    [
        MESSAGE,
        replace(MESSAGE, kinds=("initial",)),
        replace(MESSAGE, causes=(), kinds=("initial",), area="initial"),
        replace(MESSAGE, kinds=("node", "update"), term=0),
        replace(MESSAGE, kinds=("revert",), reverts=("a" * 40, "b" * 40)),
        replace(MESSAGE, causes=(), kinds=("repair",), charts=(), evidence=(), reverts=("a" * 40,)),
        replace(MESSAGE, verb="withdraw"),
        replace(MESSAGE, charts=(OTHER, CHART), evidence=("none", SUMMARY)),
    ],
)
def test_message_reads_back_equal(message: CommitMessage) -> None:
    assert read_message(write_message(message)) == message


@given(st.text(max_size=300))
def test_a_reason_cannot_forge_trailers(reason: str) -> None:
    message = read_message(write_message(replace(MESSAGE, reason=reason)))
    assert replace(message, reason="") == replace(MESSAGE, reason="")
    assert len(message.subject) <= 100


def test_one_line() -> None:
    assert one_line("a\n\nRobotKube-Evidence: all\tb") == "a RobotKube-Evidence: all b"
    assert one_line(" \n") == "no reason given"


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("deploy(recording)", "feat(recording)"), "subject"),
        ((f"RobotKube-Plan: {PLAN}\n", ""), "RobotKube-Plan must stand exactly once, found 0"),
        (("RobotKube-Event: e2\n", ""), "every task needs one"),
        (
            (f"RobotKube-Evidence: {SUMMARY}", f"RobotKube-Evidence: {SUMMARY}\nRobotKube-Evidence: none"),
            "RobotKube-Evidence must stand once per RobotKube-Chart, found 2 of 1",
        ),
        ((f"RobotKube-Evidence: {SUMMARY}\n", ""), "found 0 of 1"),
        ((f"RobotKube-Evidence: {SUMMARY}", "RobotKube-Evidence: signed"), "must be `none` or sha256:<64 hex>"),
        (("RobotKube-Event: e1", f"RobotKube-Plan: {PLAN}\nRobotKube-Event: e1"), "exactly once, found 2"),
        (("@0.1.0@", "@"), "name@version@"),
        ((f"RobotKube-Chart: {CHART}\n", ""), "RobotKube-Chart is missing"),
        (("RobotKube-Task: cloud-0/a", "RobotKube-Task: a"), "RobotKube-Task: 'a' must match"),
        (("RobotKube-Rule: near", "RobotKube-Author: me"), "is not one of the trailers"),
        (("RobotKube-Plan", "RobotKube-Cause: people\nRobotKube-Plan"), "RobotKube-Cause must be"),
        (("RobotKube-Plan", "RobotKube-Cause: initial\nRobotKube-Plan"), "must be the plan's id"),
        (("RobotKube-Plan", "RobotKube-Cause: update\nRobotKube-Cause: node\nRobotKube-Plan"), "each once, sorted"),
        (("RobotKube-Manager: manager\n", ""), "RobotKube-Manager must stand exactly once, found 0"),
        (("RobotKube-Term: 7", "RobotKube-Term: 07"), "RobotKube-Term: '07' must match"),
        (("RobotKube-Term: 7", "RobotKube-Term: 9999999999"), "is more than"),
        (("RobotKube-Plan", "RobotKube-Reverts: main\nRobotKube-Plan"), "must be a commit of 40 hex"),
        (("\n\n", "\n"), "must be empty"),
    ],
)
def test_message_refusals(change: tuple[str, str], problem: str) -> None:
    text = write_message(MESSAGE)
    assert change[0] in text
    with pytest.raises(DocumentError) as caught:
        read_message(text.replace(*change, 1))
    assert problem in str(caught.value)


def test_a_commit_without_a_cause_is_refused() -> None:
    with pytest.raises(DocumentError, match="does not say why"):
        read_message(write_message(replace(MESSAGE, causes=())))


def test_a_reason_that_the_subject_has_no_room_for_stands_before_the_trailers() -> None:
    moved = "node edge-1 lost for 41 s: " + ", ".join(f"recorder-{n} moved to cloud-0" for n in range(9))
    text = write_message(replace(MESSAGE, reason=moved))
    subject, empty, whole, after, first = text.split("\n")[:5]
    assert subject.endswith("…")
    assert (empty, whole, after) == ("", f"Reason: {moved}", "")
    assert first.startswith("RobotKube-")
    assert read_message(text).reason == moved
    assert write_message(read_message(text)) == text
    with pytest.raises(DocumentError, match="does not begin as the subject does"):
        read_message(text.replace("Reason: node edge-1", "Reason: node edge-2"))
    forged = write_message(replace(MESSAGE, reason="x" * 200 + "\nRobotKube-Task: a/b"))
    assert read_message(forged).causes == read_message(write_message(MESSAGE)).causes
