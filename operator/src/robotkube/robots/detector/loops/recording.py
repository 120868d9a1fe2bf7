"""The recording reactions of a detector, which pass edges and messages to recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from robotkube.robots.detector.core.settings import DetectorSettings
from robotkube.robots.reactions.core.settings import RecordingReactionSettings
from robotkube.robots.recording.core.plans import RecordedTopic, RecordingPlan
from robotkube.robots.rules.core import START, Edge

if TYPE_CHECKING:
    from robotkube.robots.recording.loops.recordings import Recordings
    from robotkube.robots.ros.core.gaps import Gap
    from robotkube.robots.ros.core.ring_buffers import RingBuffer

MakeRecordings = Callable[[RecordingPlan, Mapping[str, "RingBuffer"]], "Recordings"]
"""A function that gives started recordings."""


class RecordingReactions:
    """The recordings of a detector, one per recording reaction; all methods belong to the receiving thread."""

    def __init__(self, make: MakeRecordings) -> None:
        self._make = make
        self.buffers: Mapping[str, RingBuffer] = {}
        self._at_work: dict[str, Recordings] = {}
        self._leaving: list[Recordings] = []
        self._silent: frozenset[str] = frozenset()

    @property
    def at_work(self) -> tuple[Recordings, ...]:
        """The recordings at work, one for each recording reaction."""
        return tuple(self._at_work.values())

    def document(self) -> dict[str, Any]:
        """The document of `GET /recordings`; from any thread."""
        return {"recordings": [document for recordings in self.at_work for document in recordings.documents()]}

    @property
    def after_seconds(self) -> float:
        """The seconds for which the recordings go on once the process is asked to end."""
        return max((recordings.plan.after_seconds for recordings in self.at_work), default=0.0)

    @property
    def not_ready(self) -> str:
        """The reason why recordings are not ready, in words; empty when they are."""
        failed = next((recordings.failed for recordings in self.at_work if recordings.failed), "")
        waiting = [recordings.plan.recording for recordings in self.at_work if not recordings.ready]
        return failed or (f"database or volume claim has not answered yet: {', '.join(waiting)}" if waiting else "")

    def apply(self, settings: DetectorSettings) -> None:
        """Apply new settings; recordings whose plan is unchanged go on."""
        plans = {reaction.recording: recording_plan(reaction, settings) for reaction in settings.recordings}
        before = self._at_work
        self._at_work = {}
        self._leaving += [recordings for name, recordings in before.items() if plans.get(name) != recordings.plan]
        for name, plan in plans.items():
            known = before.get(name)
            same = known is not None and known.plan == plan
            self._at_work[name] = known if known is not None and same else self._make(plan, self.buffers)
        others = {other.rule for other in settings.reactions if not isinstance(other, RecordingReactionSettings)}
        recorded = {reaction.rule for reaction in settings.recordings} | {rule.name for rule in settings.rules}
        self._silent = frozenset(rule for rule in recorded - others if settings.is_always(rule))

    def leaving(self) -> list[Recordings]:
        """The recordings that are not asked for any more, once each; the caller stops them."""
        leaving = self._leaving
        self._leaving = []
        return leaving

    def of(self, topic: str) -> list[Recordings]:
        """The recordings that want the messages of a topic."""
        return [recordings for recordings in self.at_work if recordings.plan.topic(topic) is not None]

    def only(self, rule: str) -> bool:
        """Return whether a rule only makes everything be recorded: its edge is no event."""
        return rule in self._silent

    def react(self, edge: Edge, now: int) -> None:
        """Begin or end recording because of an event."""
        for recordings in self.at_work:
            if recordings.plan.rule == edge.rule:
                recordings.trigger(edge, now) if edge.edge == START else recordings.end(edge, now)

    def note_gap(self, gap: Gap) -> None:
        """Report a gap of messages that were given up on their way here."""
        for recordings in self.at_work:
            recordings.note_gap(gap)

    def tick(self, now: int) -> None:
        """Close the recordings' windows that are over at `now` (ns)."""
        for recordings in self.at_work:
            recordings.tick(now)


def recording_plan(reaction: RecordingReactionSettings, settings: DetectorSettings) -> RecordingPlan:
    """The plan of a recording reaction, with the settings of its topics."""
    by_name = {topic.pattern: topic for topic in settings.topics}
    topics = tuple(
        RecordedTopic(
            topic.pattern,
            by_name[topic.pattern].type,
            topic.storage,
            topic.before_seconds,
            topic.after_seconds,
            by_name[topic.pattern].latched,
        )
        for topic in reaction.topics
    )
    return RecordingPlan(
        rule=reaction.rule,
        recording=reaction.recording,
        volume=reaction.volume,
        topics=topics,
        always=settings.is_always(reaction.rule),
        after_seconds=reaction.after_seconds,
        trace=reaction.trace,
        provenance=reaction.provenance,
    )
