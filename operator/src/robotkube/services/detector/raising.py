"""What happens with an edge: it is kept for `/events`, told to every reaction to its rule, and logged."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from robotkube.domain.detector_settings import DetectorSettings
from robotkube.domain.notifications import delivery_id, notification
from robotkube.domain.reaction_settings import DeliveryReaction
from robotkube.domain.rules import START, STOP, Edge, reason
from robotkube.ports.reactions import Delivery, Reaction, Spans
from robotkube.services.reactions.dead import DeadLetterBox
from robotkube.services.reactions.operator import EventRecord, OperatorReactions

EVENTS_MAX = 1000

log = logging.getLogger(__name__)

MakeReaction = Callable[[DeliveryReaction, DeadLetterBox], Reaction]
"""Gives a started reaction."""


class Raising:
    """The reactions at work, apart from recordings. `react` belongs to the receiving thread."""

    def __init__(
        self,
        make_operator: Callable[[DetectorSettings, DeadLetterBox], OperatorReactions],
        make_reaction: MakeReaction,
        clock_ns: Callable[[], int],
        spans: Spans | None = None,
    ) -> None:
        self._make_operator, self._make_reaction = make_operator, make_reaction
        self._clock_ns, self._spans = clock_ns, spans
        self._settings = DetectorSettings("", ())
        self._reasons: Mapping[str, str] = {}
        self._reactions: list[tuple[DeliveryReaction, Reaction]] = []
        self._leaving: list[Reaction] = []
        self._records: deque[EventRecord] = deque(maxlen=EVENTS_MAX)
        self.box = DeadLetterBox(clock_ns)
        self.operator: OperatorReactions | None = None
        self.raised = 0

    @property
    def unreachable(self) -> list[str]:
        """Which targets cannot be reached, each in words."""
        found = [reaction.unreachable for _, reaction in self._reactions]
        if self.operator is not None and not self.operator.reachable:
            found.insert(0, "the API server has not answered yet")
        return [sentence for sentence in found if sentence]

    def apply(self, settings: DetectorSettings) -> None:
        """Take new settings; unchanged reactions go on, others deliver what they have and end."""
        self._settings = settings
        self._reasons = {rule.name: reason(rule) for rule in settings.rules}
        if self.operator is not None:
            self.operator.parent = settings.task
        elif settings.operators:
            self.operator = self._make_operator(settings, self.box)
        before, self._reactions = self._reactions, []
        for one in settings.deliveries:
            if all(one != known for known, _ in self._reactions):
                kept = next((reaction for known, reaction in before if known == one), None)
                self._reactions.append((one, kept or self._make_reaction(one, self.box)))
        at_work = [reaction for _, reaction in self._reactions]
        self._leaving += [reaction for _, reaction in before if reaction not in at_work]

    def leaving(self) -> list[Reaction]:
        """Reactions that the settings do not ask for any more, once each; who gets them stops them."""
        found, self._leaving = self._leaving, []
        return found

    def react(self, edge: Edge) -> None:
        """Tell everybody whom an edge concerns; never blocks."""
        record = EventRecord(edge)
        self._records.append(record)
        self.raised += 1
        log.info(
            "event %s: %s raised rule=%s agents=%s distance_m=%s stamp=%d time=%d",
            edge.id, edge.edge, edge.rule, ",".join(edge.agents), edge.distance_m, edge.stamp, edge.time,
        )  # fmt: skip
        why = self._reasons.get(edge.rule, "")
        reaction = next((one for one in self._settings.operators if one.rule == edge.rule), None)
        if self.operator is not None and (reaction is not None or edge.edge == STOP):
            self.operator.react(record, reaction, why)
        self._deliver(edge, why)
        if self._spans is not None:
            name = "event" if edge.edge == START else "event ends"
            agents = " ".join(edge.agents)
            attributes = {"robotkube.rule": edge.rule, "robotkube.event": edge.id, "robotkube.agents": agents}
            self._spans.span(edge.trace, name, min(edge.stamp, edge.time), self._clock_ns(), attributes)

    def stop(self, seconds: float) -> bool:
        """Deliver what waits; True when nothing is left."""
        complete = [reaction.stop(seconds) for reaction in [*(one for _, one in self._reactions), *self.leaving()]]
        if self.operator is not None:
            self.operator.stop(seconds)
        return all(complete)

    def events_document(self) -> list[dict[str, Any]]:
        """The last edges, oldest first, as `/events` shows them."""
        return [record.document() for record in list(self._records)]

    def document(self) -> dict[str, Any]:
        """The reactions as JSON values, for `/status`."""
        found = {
            reaction.name: {**reaction.counts(), "unreachable": reaction.unreachable} for _, reaction in self._reactions
        }
        if self.operator is not None:
            away = "" if self.operator.reachable else "the API server does not answer"
            found["operator"] = {**self.operator.counts(), "unreachable": away}
        return found

    def _deliver(self, edge: Edge, why: str) -> None:
        reactions = [reaction for one, reaction in self._reactions if one.rule == edge.rule]
        if not reactions:
            return
        delivery = Delivery(delivery_id(edge), edge.edge, edge.trace, notification(edge, self._settings.name, why))
        for reaction in reactions:
            reaction.react(delivery)
