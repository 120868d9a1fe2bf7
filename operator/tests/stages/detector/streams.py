"""Streams of poses through the detector, in the two ways there are: a bag through `rule test`, and live."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from robotkube.robots.detector.core.settings import read_detector_settings
from robotkube.robots.detector.loops.rule_replay import PatientWorkers, ReplayResult, replay
from tests.stages.detector.in_memory import DetectorStage, MemoryTasks
from tests.stages.detector.rules import MS, NOW, POSE, POSES, layouts, pose

TURN_NS = 16 * MS
"""How often the live detector receives."""
AFTER_NS = 50 * MS
"""How long the live detector goes on after the last message has been evaluated."""


class Sent(NamedTuple):
    """A pose of an agent: its stamp, the time of its reception (both ns since NOW), and where."""

    agent: str
    stamp: int
    received: int
    x: float
    y: float = 0.0

    @property
    def topic(self) -> str:
        """The topic it is sent on."""
        return f"/vehicles/{self.agent.replace('-', '_')}/pose"

    @property
    def data(self) -> bytes:
        """The message."""
        return pose(self.x, self.y, stamp=NOW + self.stamp)


class ReportedEdge(NamedTuple):
    """An edge, with its stamp in ns since NOW."""

    rule: str
    edge: str
    agents: tuple[str, ...]
    stamp: int
    id: str


def document(*rules: Mapping[str, Any], **topic: Any) -> dict[str, Any]:
    """The settings of a detector with these rules; `topic`: keys of its one topic."""
    return {"name": "cloud-0/test", "topics": [{"name": POSES, "type": POSE, **topic}], "rules": list(rules)}


def _no_workers() -> PatientWorkers:
    raise AssertionError("no rule here has a process")


def replayed(sent: Sequence[Sent], settings: Mapping[str, Any]) -> tuple[list[ReportedEdge], ReplayResult]:
    """The edges that `rule test` finds in a bag of these messages, and all that it says."""
    ordered = sorted(sent, key=lambda message: message.received)
    messages = [(message.topic, NOW + message.received, message.data) for message in ordered]
    types = {message.topic: POSE for message in ordered}
    result = replay(read_detector_settings(settings, "here"), layouts(), types, messages, _no_workers)
    edges = [edge for edge in result.edges if edge.rule != "time-jump"]
    return [ReportedEdge(e.rule, e.edge, e.agents, e.stamp - NOW, e.id) for e in edges], result


def lived(sent: Sequence[Sent], settings: Mapping[str, Any]) -> tuple[list[ReportedEdge], DetectorStage]:
    """The edges of a live detector that gets these messages when they are received, and the detector."""
    waiting = sorted(sent, key=lambda message: message.received)[::-1]
    stage = DetectorStage(MemoryTasks())
    stage.now = NOW + waiting[-1].received - TURN_NS
    stage.live.published = {message.topic: [POSE] for message in sent}
    stage.apply(settings, adopting=False)
    stage.detector.turn()
    last = NOW + waiting[0].received + AFTER_NS
    while stage.now < last + stage.detector.wait_ns:
        stage.now += TURN_NS
        while waiting and NOW + waiting[-1].received <= stage.now:
            message = waiting.pop()
            stage.live.topics[message.topic].waiting.append((message.data, NOW + message.received))
        stage.detector.turn()
    stage.detector.settle()
    edges = [
        ReportedEdge(e["rule"], e["edge"], tuple(e["agents"]), e["stamp"] - NOW, e["id"])
        for e in stage.events()
        if e["rule"] != "time-jump"
    ]
    return sorted(edges, key=lambda edge: edge.stamp), stage
