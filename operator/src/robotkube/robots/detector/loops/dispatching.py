"""The dispatcher of edges: it records each for `/events`, passes it to every reaction to its rule, and logs it."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from robotkube.robots.detector.core.settings import DetectorSettings
from robotkube.robots.reactions.core.notifications import delivery_id, notification
from robotkube.robots.reactions.core.settings import DeliveryReactionSettings
from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
from robotkube.robots.reactions.loops.operator import EventRecord, OperatorReactions
from robotkube.robots.reactions.ports.deliveries import EdgeDelivery, RunningReaction, Spans
from robotkube.robots.rules.core import START, STOP, Edge, reason

EVENTS_MAX = 1000

log = logging.getLogger(__name__)

MakeReaction = Callable[[DeliveryReactionSettings, DeadLetterBox], RunningReaction]
"""A function that gives a started reaction."""


class Dispatcher:
    """The dispatcher of edges to reactions, apart from recordings. `react` belongs to the receiving thread."""

    def __init__(
        self,
        make_operator: Callable[[DetectorSettings, DeadLetterBox], OperatorReactions],
        make_reaction: MakeReaction,
        clock_ns: Callable[[], int],
        spans: Spans | None = None,
    ) -> None:
        self._make_operator = make_operator
        self._make_reaction = make_reaction
        self._clock_ns = clock_ns
        self._spans = spans
        self._settings = DetectorSettings("", ())
        self._reasons: Mapping[str, str] = {}
        self._reactions: list[tuple[DeliveryReactionSettings, RunningReaction]] = []
        self._leaving: list[RunningReaction] = []
        self._records: deque[EventRecord] = deque(maxlen=EVENTS_MAX)
        self.box = DeadLetterBox(clock_ns)
        self.operator: OperatorReactions | None = None
        self.dispatched = 0

    @property
    def unreachable(self) -> list[str]:
        """The targets that cannot be reached, a sentence each."""
        sentences = [reaction.unreachable for _, reaction in self._reactions]
        if self.operator is not None and not self.operator.reachable:
            sentences.insert(0, "the API server has not answered yet")
        return [sentence for sentence in sentences if sentence]

    def apply(self, settings: DetectorSettings) -> None:
        """Apply new settings; unchanged reactions go on, others deliver what they have and end."""
        self._settings = settings
        self._reasons = {rule.name: reason(rule) for rule in settings.rules}
        if self.operator is not None:
            self.operator.parent = settings.task
        elif settings.operators:
            self.operator = self._make_operator(settings, self.box)
        before = self._reactions
        self._reactions = []
        for wanted in settings.deliveries:
            if all(wanted != known for known, _ in self._reactions):
                running = next((reaction for known, reaction in before if known == wanted), None)
                self._reactions.append((wanted, running or self._make_reaction(wanted, self.box)))
        at_work = [reaction for _, reaction in self._reactions]
        self._leaving += [reaction for _, reaction in before if reaction not in at_work]

    def leaving(self) -> list[RunningReaction]:
        """The reactions that the settings do not ask for any more, once each; the caller stops them."""
        leaving = self._leaving
        self._leaving = []
        return leaving

    def react(self, edge: Edge) -> None:
        """Dispatch an edge to every reaction to its rule; never blocks."""
        record = EventRecord(edge)
        self._records.append(record)
        self.dispatched += 1
        log.info(
            "event %s: %s dispatched rule=%s agents=%s distance_m=%s stamp=%d time=%d",
            edge.id, edge.edge, edge.rule, ",".join(edge.agents), edge.distance_m, edge.stamp, edge.time,
        )  # fmt: skip
        why = self._reasons.get(edge.rule, "")
        reaction = next((candidate for candidate in self._settings.operators if candidate.rule == edge.rule), None)
        if self.operator is not None and (reaction is not None or edge.edge == STOP):
            self.operator.react(record, reaction, why)
        self._deliver(edge, why)
        if self._spans is not None:
            name = "event" if edge.edge == START else "event ends"
            agents = " ".join(edge.agents)
            attributes = {"robotkube.rule": edge.rule, "robotkube.event": edge.id, "robotkube.agents": agents}
            self._spans.span(edge.trace, name, min(edge.stamp, edge.time), self._clock_ns(), attributes)

    def stop(self, seconds: float) -> bool:
        """Stop the reactions after they delivered what waits; True when nothing is left."""
        complete = [
            reaction.stop(seconds) for reaction in [*(running for _, running in self._reactions), *self.leaving()]
        ]
        if self.operator is not None:
            self.operator.stop(seconds)
        return all(complete)

    def events_document(self) -> list[dict[str, Any]]:
        """The last edges, oldest first, as `/events` shows them."""
        return [record.document() for record in list(self._records)]

    def document(self) -> dict[str, Any]:
        """The reactions as JSON values, for `/status`."""
        document = {
            reaction.name: {**reaction.counts(), "unreachable": reaction.unreachable} for _, reaction in self._reactions
        }
        if self.operator is not None:
            unreachable = "" if self.operator.reachable else "the API server does not answer"
            document["operator"] = {**self.operator.counts(), "unreachable": unreachable}
        return document

    def _deliver(self, edge: Edge, why: str) -> None:
        reactions = [reaction for settings, reaction in self._reactions if settings.rule == edge.rule]
        if not reactions:
            return
        delivery = EdgeDelivery(delivery_id(edge), edge.edge, edge.trace, notification(edge, self._settings.name, why))
        for reaction in reactions:
            reaction.react(delivery)
