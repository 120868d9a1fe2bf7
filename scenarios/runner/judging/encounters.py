"""Which event, plans, pods and recordings belong to one meeting of the lidar vehicles, and what was stored of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from scenarios.definition import Scenario, cloud_topic, pose_topic, transform_topic
from scenarios.runner.inputs import NANOSECONDS, AuditGap, Edge, LedgerLine, Plan, PodOfRun, RunInputs, Stored

PAIR = 2


@dataclass(frozen=True)
class Encounter:
    """One meeting: its two edges, the plans that answered them, the pods that came and went, the stored messages.

    The window, in source stamps, goes from the later of the vehicles' first stored clouds to the stop event.
    """

    scenario: Scenario
    start: Edge
    stop: Edge | None
    plan: Plan | None
    withdrawal: Plan | None
    pods: tuple[PodOfRun, ...]
    stored: tuple[Stored, ...]
    ledgers: Mapping[str, tuple[LedgerLine, ...]]
    gaps: tuple[AuditGap, ...] = ()

    @cached_property
    def agents(self) -> tuple[str, ...]:
        """The two vehicles that met."""
        return tuple(agent for agent in self.scenario.lidar_vehicles if agent in self.start.agents)

    @cached_property
    def topics(self) -> tuple[str, ...]:
        """The four topics of the window: poses and clouds of both vehicles."""
        return tuple(topic(agent) for topic in (pose_topic, cloud_topic) for agent in self.agents)

    @cached_property
    def pose_topics(self) -> tuple[str, ...]:
        """Topics of the poses alone."""
        return tuple(pose_topic(agent) for agent in self.agents)

    @cached_property
    def cloud_topics(self) -> tuple[str, ...]:
        """Topics of the clouds alone."""
        return tuple(cloud_topic(agent) for agent in self.agents)

    @cached_property
    def readable(self) -> tuple[Stored, ...]:
        """Stored messages whose bytes could be read back."""
        return tuple(message for message in self.stored if message.sha256)

    @cached_property
    def window(self) -> tuple[int, int] | None:
        """First and last source stamp of the window; None when a vehicle has no cloud in storage or nothing stopped
        it."""
        firsts = [min(self.stamps(topic), default=None) for topic in self.cloud_topics]
        if self.stop is None or None in firsts:
            return None
        return max(first for first in firsts if first is not None), self.stop.stamp

    @property
    def window_seconds(self) -> float | None:
        """Length of the window in s; None without one, or when the recording began only after the stop."""
        if self.window is None or self.window[1] <= self.window[0]:
            return None
        return (self.window[1] - self.window[0]) / NANOSECONDS

    def count(self, topics: Sequence[str]) -> int:
        """Distinct messages of `topics` inside the window that are in storage and can be read."""
        return sum(1 for topic in topics for stamp in self.stamps(topic) if self._inside(stamp))

    @property
    def lost(self) -> int | None:
        """Ledger lines of the four topics inside the window that are not in storage; None without a window or a
        ledger."""
        return self.lost_of(self.topics)

    def lost_of(self, topics: Sequence[str]) -> int | None:
        """The same of some topics."""
        if self.window is None or any(not self.ledgers.get(topic) for topic in topics):
            return None
        begin, end = self.window
        lost = 0
        for topic in topics:
            stored = self.stamps(topic)
            lost += sum(begin <= line.stamp <= end and line.stamp not in stored for line in self.ledgers[topic])
        return lost

    @cached_property
    def duplicates(self) -> int:
        """Messages in storage beyond the first of the same recording, topic and stamp."""
        counts = Counter((message.recording, message.topic, message.stamp) for message in self.stored)
        return sum(count - 1 for count in counts.values())

    @cached_property
    def unequal(self) -> int:
        """Stored messages whose bytes are not those the ledger states, or that no ledger knows."""
        stated = {(topic, line.stamp): line.sha256 for topic, lines in self.ledgers.items() for line in lines}
        return sum(stated.get((message.topic, message.stamp)) != message.sha256 for message in self.readable)

    @property
    def transforms_missing(self) -> int:
        """Lidars whose mounting is not in the recording."""
        topics = {message.topic for message in self.readable}
        return sum(transform_topic(agent) not in topics for agent in self.agents)

    @cached_property
    def first_cloud(self) -> Stored | None:
        """The cloud that was stored first."""
        clouds = [message for message in self.readable if message.topic in self.cloud_topics and message.stored]
        return min(clouds, key=lambda message: message.stored or 0, default=None)

    @property
    def removed(self) -> int | None:
        """The deletion of the last pod object of the withdrawn releases; None while one lives or none was seen."""
        deleted = [pod.deleted for pod in self.pods]
        if not deleted or None in deleted:
            return None
        return max(moment for moment in deleted if moment is not None)

    def _inside(self, stamp: int) -> bool:
        return self.window is not None and self.window[0] <= stamp <= self.window[1]

    def stamps(self, topic: str) -> frozenset[int]:
        """The stamps of a topic's messages in storage."""
        return self._stamps_by_topic.get(topic, frozenset())

    @cached_property
    def _stamps_by_topic(self) -> Mapping[str, frozenset[int]]:
        stamps: dict[str, set[int]] = {}
        for message in self.readable:
            stamps.setdefault(message.topic, set()).add(message.stamp)
        return {topic: frozenset(values) for topic, values in stamps.items()}


def encounters(scenario: Scenario, inputs: RunInputs) -> tuple[Encounter, ...]:
    """The meetings of the run in order of time: rising edges of the story's rule for two of the lidar vehicles."""
    edges = [edge for edge in inputs.edges if edge.rule == scenario.story.rule and edge.time >= inputs.started]
    starts = sorted((edge for edge in edges if _starts(scenario, edge)), key=lambda edge: edge.time)
    stops = {edge.id: edge for edge in edges if edge.edge == "stop"}
    return tuple(
        _encounter(scenario, inputs, start, stops.get(start.id), _next(start, starts[number:], inputs.ended))
        for number, start in enumerate(starts, 1)
    )


def _starts(scenario: Scenario, edge: Edge) -> bool:
    return edge.edge == "start" and len(edge.agents) == PAIR and set(edge.agents) <= set(scenario.lidar_vehicles)


def _next(start: Edge, later: Sequence[Edge], ended: int) -> int:
    """The time at which the same two meet again, or else the run's end."""
    return next((edge.time for edge in later if set(edge.agents) == set(start.agents)), ended)


def _encounter(scenario: Scenario, inputs: RunInputs, start: Edge, stop: Edge | None, end: int) -> Encounter:
    mine = [plan for plan in inputs.plans if start.id in plan.events or (start.task and start.task in plan.tasks)]
    mine.sort(key=lambda plan: (plan.merged is None, plan.started or 0))  # one that was turned down is proposed again
    plan = next((plan for plan in mine if plan.cause == "task"), None)
    withdrawal = next((one for one in mine if one is not plan and (one.cause == "withdrawal" or one.removed)), None)
    names = {recording.name for recording in inputs.recordings if recording.event == start.id}
    names |= {recording.name for recording in inputs.recordings if start.task and recording.task == start.task}
    return Encounter(
        scenario=scenario,
        start=start,
        stop=stop,
        plan=plan,
        withdrawal=withdrawal,
        pods=_pods(inputs, plan, start.time, end),
        stored=tuple(message for message in inputs.stored if message.recording in names),
        ledgers=inputs.ledgers,
        gaps=tuple(gap for gap in inputs.gaps if gap.recording in names),
    )


def _pods(inputs: RunInputs, plan: Plan | None, begin: int, end: int) -> tuple[PodOfRun, ...]:
    """Pods that the releases made by the plan had from `begin` to `end`; release <namespace>/<name> has pods
    <name>-..."""
    owners = [release.split("/", 1) for release in plan.created] if plan else []
    return tuple(
        pod
        for pod in inputs.pods
        if any(pod.namespace == namespace and pod.name.startswith(f"{name}-") for namespace, name in owners)
        and pod.created < end
        and (pod.deleted is None or pod.deleted >= begin)
    )
