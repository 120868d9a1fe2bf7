"""A changed rule of a detector, merged in Git, is at work in the same process and on the same buffer.

How soon: one change among many is among the slower proofs, with the share that must be in time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest
import yaml

from scenarios.definition import pose_topic
from scenarios.generator.messages import POSE_TYPE
from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import BRIDGE, Stage, pose

AGENT, OTHER = "vehicle-02", "vehicle-01"
RELEASE = f"{AGENT}/event-detector"
TOPIC = pose_topic(AGENT)
ACTIVE_SECONDS_MAX = 5.0
APPLIED_SECONDS_MAX = 60.0
MANY, SHARE = 20, 0.95
HERTZ, BUFFER_SECONDS = 10, 10
FULL = HERTZ * (BUFFER_SECONDS - 2)
FIRST_METRES = 100


def detector(distance: int) -> dict[str, Any]:
    """What a person asks for: a detector on a vehicle, with this start distance."""
    parameters = {"agents": [AGENT, OTHER], "start_distance_m": distance, "stop_distance_m": 1000}
    return {"application": "proximity-operator", "agents": [AGENT], "parameters": parameters}


@dataclass
class Watched:
    """The one pod of the detector; `asked` is what main asks for now."""

    stage: Stage
    pod: str
    asked: dict[str, Any]

    def status(self) -> Mapping[str, Any]:
        """`/status`, as it is now."""
        return dict(self.stage.platform.access.pod_json(AGENT, self.pod, "status"))

    def restarts(self) -> int:
        """Of its containers, all together."""
        pod = self.stage.platform.get("-n", AGENT, "pod", self.pod)
        return sum(one["restartCount"] for one in pod["status"]["containerStatuses"])

    def ask(self, entry: dict[str, Any]) -> None:
        """A person's pull request with another distance."""
        self.stage.ask_otherwise(self.asked, entry)
        self.asked = entry

    def seconds_of_change(self, distance: int) -> float:
        """From the commit that has the rule to the moment at which the detector has taken it."""
        before = self.status()["settings"]["applied"]
        self.ask(detector(distance))
        applied = eventually(
            f"a start distance of {distance} m is at work", lambda: self._applied_after(before), APPLIED_SECONDS_MAX
        )
        assert self._distance() == distance
        return float(applied) / 1e9 - self.stage.commit_of(RELEASE).time

    def _applied_after(self, before: int) -> int:
        settings = self.status()["settings"]
        assert settings["refused"] == ""
        return int(settings["applied"]) if settings["applied"] > before else 0

    def _distance(self) -> int:
        config_map = self.stage.platform.get("-n", AGENT, "configmap", "event-detector")
        (rule,) = yaml.safe_load(config_map["data"]["config.yaml"])["rules"]
        return int(rule["start_distance_m"])


@contextmanager
def watched(stage: Stage) -> Iterator[Watched]:
    """The detector runs beside a pose that comes all the time, and its buffer is full."""
    first = detector(FIRST_METRES)
    with (
        stage.asked_by_a_person(first),
        stage.publishing(f"{AGENT}/{BRIDGE}", (TOPIC, POSE_TYPE, pose(0.0)), hertz=HERTZ),
    ):
        rule_watch = Watched(stage, stage.await_running(RELEASE)[RELEASE].name, first)
        try:
            eventually("the buffer is full", lambda: buffered(rule_watch.status()) >= FULL)
            yield rule_watch
        finally:
            if rule_watch.asked != first:
                rule_watch.ask(first)


def buffered(status: Mapping[str, Any]) -> int:
    """Messages in the buffer of the topic."""
    return int(status["topics"].get(TOPIC, {}).get("buffer", {}).get("messages", 0))


def test_a_merged_rule_is_at_work_and_the_buffer_is_kept(stage: Stage) -> None:
    changed(stage, 1)


@pytest.mark.thorough
def test_merged_rules_are_at_work_in_time(stage: Stage) -> None:
    changes = changed(stage, MANY)
    assert sum(seconds <= ACTIVE_SECONDS_MAX for seconds in changes) >= SHARE * MANY, changes


def changed(stage: Stage, changes: int) -> list[float]:
    """Seconds of each of so many changes of one detector, which keeps its process and its buffer."""
    seconds: list[float] = []
    with watched(stage) as reloaded:
        before = reloaded.status()
        for number in range(1, changes + 1):
            seconds.append(reloaded.seconds_of_change(FIRST_METRES + number))
            after = reloaded.status()
            assert buffered(after) >= FULL, "what was buffered is still there"
        assert after["topics"][TOPIC]["buffer"]["cleared"] == 0
        assert after["topics"][TOPIC]["received"] > before["topics"][TOPIC]["received"]
        assert (after["started"], after["rules"]["names"]) == (before["started"], before["rules"]["names"])
        assert [pod.name for pod in stage.pods(RELEASE)] == [reloaded.pod]
        assert reloaded.restarts() == 0
    return seconds
