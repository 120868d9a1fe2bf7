"""Circles of links: topics that would leave and enter one agent by its bridge, so that each message would come back.

They are looked for over all samples of an application's parameters together, and for two agents where it runs by
itself: what two demands would do to each other is found before anybody asks for the second one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice, product
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.applications import Application, Link
from robotkube.registry.catalogue.core.links.loops import joined, loops_of, repetitions

REPETITIONS_MAX = 16
ENDS_MAX = 16

_End = tuple[str, Mapping[str, Any]]
"""The words for a place, and the loop of the service instance there."""


def circle_problems(
    application: Application, samples: Iterable[Mapping[str, Any]], agents: Sequence[str], render: Render
) -> Iterator[tuple[str, str]]:
    """The problems, each with its key. `samples` are names for templates; `agents` those for which an application that
    runs by itself runs. What cannot be rendered is left out: others report it."""
    traffic = _Traffic(application, agents, render)
    for names in samples:
        for index, link in enumerate(application.links):
            if link.kind != "ros":
                traffic.add(index, link, names)
    yield from traffic.circles()


class _Traffic:
    """Who sends and who receives each topic, with the index of the link that says so."""

    def __init__(self, application: Application, agents: Sequence[str], render: Render) -> None:
        self._application = application
        self._agents = agents
        self._render = render
        self._senders: dict[str, dict[str, int]] = defaultdict(dict)
        self._receivers: dict[str, dict[str, int]] = defaultdict(dict)

    def add(self, index: int, link: Link, names: Mapping[str, Any]) -> None:
        """Add what a link gives with these names."""
        try:
            for loop in islice(repetitions(link, self._application.services, names, self._render), REPETITIONS_MAX):
                self._add(index, link, {**names, **loop}, loop)
        except DocumentError:
            return

    def _add(self, index: int, link: Link, scope: Mapping[str, Any], loop: Mapping[str, Any]) -> None:
        topics = [str(self._render(topic.get("name", ""), scope)) for topic in link.topics]
        ends = [
            [one for one in self._ends(end, scope) if joined(loop, one[1]) is not None]
            for end in (link.source, link.target)
        ]
        for (sender, its), (receiver, others) in product(*ends):
            if sender == receiver or joined(its, others) is None:
                continue
            for topic in topics:
                if "medium" not in link.source:
                    self._senders[topic].setdefault(sender, index)
                if "medium" not in link.target:
                    self._receivers[topic].setdefault(receiver, index)

    def _ends(self, end: Mapping[str, str], scope: Mapping[str, Any]) -> Iterator[_End]:
        if "medium" in end:
            yield "the medium", {}
        elif "service" in end:
            yield from islice(self._instances(end["service"], scope), ENDS_MAX)
        elif "role" in end:
            role = self._render(end["role"], scope)
            own = role == self._application.initial_for
            yield from ((name, {}) for name in (self._agents if own else (f"a {role}", f"another {role}")))
        else:
            yield str(self._render(end["agent"], scope)), {}

    def _instances(self, name: str, scope: Mapping[str, Any]) -> Iterator[_End]:
        for service in self._application.services:
            if service.name != name:
                continue
            for loop in loops_of(service.for_each, scope, self._render):
                placed = service.placement.agent
                words = f"service {name} {' '.join(map(str, loop.values()))}".strip()
                yield (str(self._render(placed, {**scope, **loop})) if placed else words), loop

    def circles(self) -> Iterator[tuple[str, str]]:
        """Every topic that one place sends and receives, once per pair of links."""
        known = set()
        for topic, senders in self._senders.items():
            for place in sorted(senders.keys() & self._receivers[topic].keys()):
                pair = (senders[place], self._receivers[topic][place])
                if pair not in known:
                    known.add(pair)
                    yield f"spec.links[{pair[0]}]", _circle(topic, place, pair[1])


def _circle(topic: str, place: str, other: int) -> str:
    return (
        f"topic {topic} leaves {place} and enters it again by spec.links[{other}]: each message would come back; give "
        "the way back a topic of its own, or name the topic after the agent that sends it"
    )
