"""Messages are published when they are due, several in a call, on real ROS."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.stages.ros import due_publisher
from tests.stages.waiting import until

pytestmark = pytest.mark.processes


def test_messages_are_published_when_they_are_due(start: Callable[..., subprocess.Popen[str]], tmp_path: Path) -> None:
    process = start("-m", "tests.stages.ros.due_publisher", "/due", str(tmp_path / "results.json"))
    until(lambda: process.poll() is not None)
    assert process.returncode == 0
    results = json.loads((tmp_path / "results.json").read_text())

    turns = results["in_turns"]
    assert turns["outcome"] == [due_publisher.COUNT, 0, ""]
    assert turns["took"] >= (due_publisher.COUNT - 1) * due_publisher.STEP_NS
    for place, messages in enumerate(turns["taken"]):
        numbers = [number for number, _ in messages]
        assert numbers == list(range(place, due_publisher.COUNT, 2))
        assert all(after >= number * due_publisher.STEP_NS for number, after in messages), "none before its time"
    assert turns["turns"] >= 1, "another thread ran meanwhile"

    assert results["past"] == [3, 1, ""]
    assert results["signal"]["outcome"] == [1, 0, ""]
    assert len(results["signal"]["seen"]) == 1, "the interpreter got the signal, and the call waited for it"
    assert results["signal"]["turns"] > 10, "another thread ran between the first message and the end of the call"
    assert results["signal"]["seconds"] < 600, "the call did not wait for the second message"
    assert results["none"] == [0, 0, ""]
    assert results["wrong"] == "TypeError"
    assert results["closed"] == [1, 1, "the publisher is closed"]
