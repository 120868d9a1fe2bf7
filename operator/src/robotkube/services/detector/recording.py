"""The recording reactions of a detector: which recording an edge or a message goes to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from robotkube.domain.detector_settings import DetectorSettings
from robotkube.domain.reaction_settings import RecordingReaction
from robotkube.domain.recording_plans import RecordedTopic, RecordingPlan
from robotkube.domain.rules import START, Edge

if TYPE_CHECKING:
    from robotkube.domain.audits import Gap
    from robotkube.domain.buffers import RingBuffer
    from robotkube.services.recording.recordings import Recordings

MakeRecordings = Callable[[RecordingPlan, Mapping[str, "RingBuffer"]], "Recordings"]
"""Gives started recordings."""


class RecordingReactions:
    """All methods belong to the receiving thread."""

    def __init__(self, make: MakeRecordings) -> None:
        self._make = make
        self.buffers: Mapping[str, RingBuffer] = {}
        self._at_work: dict[str, Recordings] = {}
        self._leaving: list[Recordings] = []
        self._silent: frozenset[str] = frozenset()

    @property
    def at_work(self) -> tuple[Recordings, ...]:
        """One for each recording reaction."""
        return tuple(self._at_work.values())

    @property
    def after_seconds(self) -> float:
        """How long the recordings go on once the process is asked to end."""
        return max((one.plan.after_seconds for one in self.at_work), default=0.0)

    @property
    def not_ready(self) -> str:
        """What is waited for, in words; empty for nothing."""
        waiting = [one.plan.recording for one in self.at_work if not one.ready]
        return f"database or claim has not answered yet: {', '.join(waiting)}" if waiting else ""

    def apply(self, settings: DetectorSettings) -> None:
        """Take new settings; recordings whose plan is unchanged go on."""
        plans = {reaction.recording: recording_plan(reaction, settings) for reaction in settings.recordings}
        before, self._at_work = self._at_work, {}
        self._leaving += [one for name, one in before.items() if plans.get(name) != one.plan]
        for name, plan in plans.items():
            known = before.get(name)
            same = known is not None and known.plan == plan
            self._at_work[name] = known if known is not None and same else self._make(plan, self.buffers)
        others = {one.rule for one in settings.reactions if not isinstance(one, RecordingReaction)}
        recorded = {reaction.rule for reaction in settings.recordings} | {rule.name for rule in settings.rules}
        self._silent = frozenset(rule for rule in recorded - others if settings.is_always(rule))

    def leaving(self) -> list[Recordings]:
        """Recordings that are not asked for any more, once each; who gets them stops them."""
        found, self._leaving = self._leaving, []
        return found

    def of(self, topic: str) -> list[Recordings]:
        """The recordings that want the messages of a topic."""
        return [one for one in self.at_work if one.plan.topic(topic) is not None]

    def only(self, rule: str) -> bool:
        """Whether a rule just says that everything is recorded: its edge is no news."""
        return rule in self._silent

    def react(self, edge: Edge, now: int) -> None:
        """Begin or end what is recorded because of an event."""
        for one in self.at_work:
            if one.plan.rule == edge.rule:
                one.trigger(edge, now) if edge.edge == START else one.end(edge, now)

    def lack(self, gap: Gap) -> None:
        """Messages were given up on their way here."""
        for one in self.at_work:
            one.lack(gap)

    def tick(self, now: int) -> None:
        """Close what is over."""
        for one in self.at_work:
            one.tick(now)


def recording_plan(reaction: RecordingReaction, settings: DetectorSettings) -> RecordingPlan:
    """What the reaction asks for, with what the settings say of its topics."""
    by_name = {topic.pattern: topic for topic in settings.topics}
    topics = tuple(
        RecordedTopic(
            one.pattern,
            by_name[one.pattern].type,
            one.storage,
            one.before_seconds,
            one.after_seconds,
            by_name[one.pattern].latched,
        )
        for one in reaction.topics
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
