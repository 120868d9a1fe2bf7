"""Trailers of commit messages: what is written is read back, and what only looks like one says nothing."""

from __future__ import annotations

import pytest

from robotkube.foundation.forge.core.trailers import (
    APPROVED_BY,
    PULL_REQUEST,
    claims,
    named,
    read_trailer,
    read_trailers,
    trailer,
)

MESSAGE = """deploy(recording): RobotKube-Plan: none

Reason: RobotKube-Rule: made up
RobotKube-Chart: a@1@sha256:1
RobotKube-Chart: b@1@sha256:2
RobotKube-Pull-Request: 7
"""


def test_a_line_is_read_as_it_is_written() -> None:
    assert trailer("Term", 7) == "RobotKube-Term: 7"
    assert read_trailer(trailer(APPROVED_BY, "reviewer")) == (APPROVED_BY, "reviewer")
    assert named("Chart") == "RobotKube-Chart"


@pytest.mark.parametrize(
    "line",
    [
        "",
        "RobotKube-Plan:",
        "RobotKube-Plan: ",
        "RobotKube-Plan:a",
        "RobotKube-Plan: a b",
        "RobotKube-plan: a",
        "RobotKube-Pull-: 7",
        " RobotKube-Plan: a",
        "RobotKube-Plan: a\n",
        "Signed-off-by: a",
    ],
)
def test_what_only_looks_like_one_is_none(line: str) -> None:
    assert read_trailer(line) is None


def test_a_message_has_words_by_key_in_their_order() -> None:
    assert read_trailers(MESSAGE) == {"Chart": ("a@1@sha256:1", "b@1@sha256:2"), PULL_REQUEST: ("7",)}


@pytest.mark.parametrize(
    ("message", "claimed"),
    [
        (MESSAGE, False),
        (f"{MESSAGE}RobotKube-Plan: \n", True),
        (f"{MESSAGE}RobotKube-Plan: two words\n", True),
        (f"{MESSAGE}RobotKube-Planned: a\n", False),
    ],
)
def test_a_trailer_is_claimed_also_by_a_line_that_is_none(message: str, claimed: bool) -> None:
    assert claims(message, "Plan") == claimed
