"""One run of the scenario in a process of its own, as a person starts it, with the agents' pods watched meanwhile."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ci.folders import PROJECT
from scenarios.runner.inputs import InputCounters
from scenarios.runner.observing import collecting
from scenarios.runner.waiting import RunError
from tests.stages.platform.running_platform import Platform

STORY_SECONDS_MAX = 420
POLL_SECONDS = 1.0
BRIDGE = "mqtt-bridge"


@dataclass(frozen=True)
class Story:
    """What a run did: exit code, what it printed and said, its report; `pods` by UID as last seen, of all agents;
    counters of the event detector before (None: it did not run yet) and after."""

    code: int
    output: str
    talk: str
    report: Mapping[str, Any]
    pods: Mapping[str, Mapping[str, Any]]
    before: InputCounters | None
    after: InputCounters

    def of(self, name: str) -> list[Mapping[str, Any]]:
        """The pods seen of a chart."""
        return [pod for pod in self.pods.values() if pod["metadata"]["labels"].get("app.kubernetes.io/name") == name]


def counters(platform: Platform) -> InputCounters | None:
    """What the event detector has received so far; None when there is none yet."""
    try:
        return collecting.input_counters(platform.access, platform.scenario)
    except RunError:
        return None


def play(platform: Platform, scenario: Path, variant: str, folder: Path, seconds: float = STORY_SECONDS_MAX) -> Story:
    """Run to the end, for at most so many seconds; the run itself is judged by tests."""
    before = counters(platform)
    pods = {}
    output, talk = folder / "output", folder / "talk"
    command = [sys.executable, "-m", "scenarios.runner", "run", str(scenario), "--name", platform.name]
    command += [*(("--variant", variant) if variant else ()), "--reports", str(folder)]
    with output.open("w") as out, talk.open("w") as said:
        process = subprocess.Popen(command, cwd=PROJECT, stdout=out, stderr=said)
        try:
            end = time.monotonic() + seconds
            while process.poll() is None and time.monotonic() < end:
                listed = platform.get("pods", "-A", "-l", "robotkube.io/agent")["items"]
                pods |= {pod["metadata"]["uid"]: pod for pod in listed}
                time.sleep(POLL_SECONDS)
        finally:
            process.kill()
            code = process.wait()
    report = folder / scenario.name / "report.json"
    document = json.loads(report.read_text()) if report.is_file() else {}
    after = collecting.input_counters(platform.access, platform.scenario)
    return Story(code, output.read_text(), talk.read_text(), document, pods, before, after)
