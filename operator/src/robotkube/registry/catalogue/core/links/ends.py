"""Topics of links that the charts at their ends open otherwise, or not at all.

ROS says nothing where it connects nothing: a subscription gets nothing of another type, and nothing where it requests
more than is offered. A bridge subscribes as the link says where a topic comes from, and publishes as the link says
where it goes. What the charts say is in their entries' interfaces.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.applications import Link
from robotkube.registry.catalogue.core.expected_topics import (
    COMMON_TOPICS,
    IN,
    MQTT,
    OUT,
    ROS,
    ExpectedTopic,
    interface_topics,
)
from robotkube.registry.catalogue.core.links.loops import joined

Problem = tuple[str, str]
"""Key below the link's topic, text."""

TOPICS_SHOWN_MAX = 5
AT_THE_BROKER = "mqtt"
"""A ROS topic stands at the broker below this; a chart may read and write it there by itself."""

_MORE = {"reliability": ("reliable", "best_effort"), "durability": ("transient_local", "volatile")}
"""By key of a topic's quality: the word that asks for more, and the one that does not give it."""


@dataclass(frozen=True)
class Opening:
    """What an instance of a service opens: `topics` by its chart's entry and its values, None where that says nothing.
    `place` is the same for instances on one node; `loop` are the values of the service's `forEach` variables."""

    service: str
    chart: str
    place: str
    loop: Mapping[str, Any] = field(default_factory=dict)
    topics: tuple[ExpectedTopic, ...] | None = None

    def has(self, name: str, direction: str) -> Iterator[ExpectedTopic]:
        """Its interfaces of a direction that have the ROS topic of this name."""
        yield from (topic for topic in self.topics or () if _is_at(topic, ROS, direction) and topic.matches(name))

    def passes(self, name: str, direction: str) -> bool:
        """Return whether it opens the topic, in the ROS graph or at the broker itself."""
        at_the_broker = (topic for topic in self.topics or () if _is_at(topic, MQTT, direction))
        named = any(one.matches(f"{AT_THE_BROKER}{name}") for one in at_the_broker)
        return named or any(self.has(name, direction))


def _is_at(topic: ExpectedTopic, medium: str, direction: str) -> bool:
    return topic.medium == medium and topic.direction == direction


def opened(
    interfaces: Sequence[Mapping[str, Any]], values: Mapping[str, Any], render: Render
) -> tuple[ExpectedTopic, ...] | None:
    """The topics that interfaces give for the chart's merged values; None when there are no interfaces, or these values
    give no topic for one of them, which others report."""
    if not interfaces:
        return None
    try:
        return tuple(topic for interface in interfaces for topic in interface_topics(interface, values, render))
    except DocumentError:
        return None


def together(every: Sequence[Opening], links: Sequence[Link]) -> list[Opening]:
    """The same, with one place for all that links of kind ros keep on one node."""
    placed = list(every)
    for link in (one for one in links if one.kind == "ros"):
        for first in [one for one in placed if one.service == link.source["service"]]:
            for second in [one for one in placed if one.service == link.target["service"]]:
                if joined(first.loop, second.loop) is not None:
                    places = {one.place for one in placed if _same(one, first) or _same(one, second)}
                    placed = [replace(one, place=min(places)) if one.place in places else one for one in placed]
    return placed


def _same(one: Opening, other: Opening) -> bool:
    return one.service == other.service and one.chart == other.chart and one.loop == other.loop


def taking_part(end: Mapping[str, str], loop: Mapping[str, Any], every: Sequence[Opening]) -> list[Opening | None]:
    """The instances at an end of a link that take part in its repetition; None where the end is no service."""
    if "service" not in end:
        return [None]
    return [one for one in every if one.service == end["service"] and joined(loop, one.loop) is not None]


def mismatches(
    topic: Mapping[str, Any], source: Opening | None, target: Opening | None, every: Sequence[Opening]
) -> Iterator[Problem]:
    """Why a topic of a link, rendered, does not get from the instance where it comes from, or to the one where it goes.
    `every` are the openings of all instances of the application."""
    for opening, direction in ((source, OUT), (target, IN)):
        if opening is None:
            continue
        name = str(topic["name"])
        beside = [one for one in every if one.place == opening.place]
        opens = [(one, interface) for one in beside for interface in one.has(name, direction)]
        for one, interface in opens:
            yield from _differences(topic, one, interface)
        if not opens and opening.topics is not None and (name, direction) not in COMMON_TOPICS:
            yield from _missing(name, direction, opening, every)


def _differences(topic: Mapping[str, Any], opening: Opening, interface: ExpectedTopic) -> Iterator[Problem]:
    where = f"interface {interface.interface} of chart {opening.chart} (service {opening.service})"
    verb = "sends" if interface.direction == OUT else "takes"
    if topic["type"] != interface.type:
        yield (
            "type",
            f"topic {interface.topic} is {topic['type']} here, and {where} {verb} {interface.type}: nothing would "
            f"arrive; write {interface.type}, or correct the chart",
        )
    for key, (more, less) in _MORE.items():
        offers = str(topic[key])
        requests = getattr(interface, key)
        if interface.direction == OUT:
            offers, requests = requests, offers
        if offers == less and requests == more:
            here, there = ("requests", "offers") if interface.direction == OUT else ("offers", "requests")
            right = getattr(interface, key)
            yield (
                key,
                f"topic {interface.topic}: the link {here} {topic[key]}, and {where} {there} {right}: ROS does not "
                f"connect who requests {more} with who offers {less}; write {right}, or correct the chart",
            )


def _missing(name: str, direction: str, opening: Opening, every: Sequence[Opening]) -> Iterator[Problem]:
    """The topic is that of no instance of the service, and of none beside it on its node."""
    possible = [one for one in every if one.service == opening.service or one.place == opening.place]
    if any(one.topics is None or one.passes(name, direction) for one in possible):
        return
    names = dict.fromkeys(topic.topic for topic in opening.topics or () if _is_at(topic, ROS, direction))
    listed = ", ".join(list(names)[:TOPICS_SHOWN_MAX])
    verb, other = ("sends", "from") if direction == OUT else ("takes", "to")
    fix = "name one of them, give" if names else "give"
    yield (
        "name",
        f"no interface of chart {opening.chart} (service {opening.service}) {verb} {name} in ROS (direction "
        f"{direction}): it has {listed or 'none'}; {fix} the service values with this topic, or write another end "
        f"under `{other}`",
    )
