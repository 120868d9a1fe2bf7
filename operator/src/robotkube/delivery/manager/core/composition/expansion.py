"""Expansion of one demand: the releases on agents, and the topics of bridges, that it asks for.

Templates may use where earlier services were placed, so choosing versions, placing and rendering go service by service.
An expansion stays good as long as its lookups and pins have the same answers and every group is placed where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from robotkube.delivery.deployment.core.borders import said_as
from robotkube.delivery.deployment.core.heard_topics import heard_topics
from robotkube.delivery.deployment.core.releases import Release, TaskCause, application_name
from robotkube.delivery.manager.core.composition.assignments import Assignments
from robotkube.delivery.manager.core.composition.co_location import Instance, groups, instances
from robotkube.delivery.manager.core.composition.index import Index, Lookup
from robotkube.delivery.manager.core.composition.inputs import Demand
from robotkube.delivery.manager.core.composition.links import PlacedInstance, needs, passages
from robotkube.delivery.manager.core.composition.publishers import (
    Publisher,
    Publishers,
    declares_topics,
    described,
    is_one_publishers,
    published_topics,
)
from robotkube.delivery.manager.core.composition.selection import Chosen
from robotkube.delivery.manager.core.composition.topic_merge import End, MergedTopics
from robotkube.delivery.manager.core.placement.capacity import read_resources
from robotkube.delivery.manager.core.placement.placement import (
    GUEST,
    Agent,
    Group,
    Placement,
    PlacementRequest,
    group,
)
from robotkube.errors import RefusalError
from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.value_templates import render_templates
from robotkube.registry.catalogue.core.applications import Link
from robotkube.registry.catalogue.core.catalogue import Pin
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.links.ends import Opening, opened
from robotkube.robots.bridge.core.rights import IN, OUT

MQTT = "mqtt"
"""The kind of link that leaves a node."""

T = TypeVar("T")


@dataclass(frozen=True)
class PlacedGroup:
    """A group that was placed: its releases' names, and where it went."""

    group: Group
    names: tuple[Any, ...]
    placement: Placement


@dataclass
class Expansion:
    """What a demand asks for. `merged_lists` are, by release key, the values paths whose lists are merged when another
    demand makes the same release; `published` are the topics of its releases and of bridges, as far as that is known;
    `lookups`, `kept` and `pins` are what it depends on beside catalogue and placements: answers of the fleet, where its
    releases (by name) ran already, and the versions that releases (by key) keep."""

    demand: Demand
    application: str
    cause: TaskCause | None
    releases: dict[str, Release] = field(default_factory=dict)
    merged_lists: dict[str, tuple[str, ...]] = field(default_factory=dict)
    topics: MergedTopics = field(default_factory=MergedTopics)
    published: Publishers = field(default_factory=dict)
    groups: list[PlacedGroup] = field(default_factory=list)
    choice_parts: list[tuple[str, ...] | int] = field(default_factory=list)
    lookups: list[tuple[Lookup, Any]] = field(default_factory=list)
    kept: list[tuple[Any, frozenset[str]]] = field(default_factory=list)
    pins: list[tuple[str, Pin | None]] = field(default_factory=list)
    choices: tuple[str, ...] = ()

    def with_placements(self, placements: Iterable[Placement]) -> Expansion:
        """The same with other reasons for the same places."""
        placed = [replace(one, placement=now) for one, now in zip(self.groups, placements, strict=True)]
        return replace(self, groups=placed, choices=choices_of(self.choice_parts, placed))


def choices_of(parts: Sequence[tuple[str, ...] | int], placed: Sequence[PlacedGroup]) -> tuple[str, ...]:
    """Every choice, as a sentence: texts as they are, and for a number the reasons of the group with that number."""
    texts = [(placed[part].placement.reasons if isinstance(part, int) else part) for part in parts]
    return tuple(text for group_texts in texts for text in group_texts)


def expand(demand: Demand, index: Index, assignments: Assignments) -> Expansion:
    """Everything that the demand asks for, its groups assigned; RefusalError or DocumentError when it cannot be met."""
    return _sending(demand, index) if demand.sent else _Expander(demand, index, assignments).expanded()


def _sending(demand: Demand, index: Index) -> Expansion:
    """A topic that the agent's bridge sends."""
    expansion = Expansion(demand, demand.application, None)
    lookup = ("agent", demand.agent)
    agent = index.lookup(lookup)
    expansion.lookups.append((lookup, agent))
    index.bridge(MQTT)
    expansion.topics.add(MQTT, agent.place, OUT, demand.sent, lambda end, topic: "")
    return expansion


class _Expander:
    """Expands one demand."""

    def __init__(self, demand: Demand, index: Index, assignments: Assignments) -> None:
        self._demand = demand
        self._index = index
        self._assignments = assignments
        self._render = index.render
        self._placements: dict[str, str] = {}

    def expanded(self) -> Expansion:
        """The expansion, as `expand` returns it."""
        demand = self._demand
        index = self._index
        kept = index.kept_application(demand) if demand.provides else ""
        choice = index.selector.application(demand, kept)
        cause = replace(demand.task.cause, application=choice.application.name) if demand.task else None
        self._expansion = Expansion(demand, choice.application.name, cause, choice_parts=[choice.reasons])
        names = self._given = _names(demand, choice.parameters, self._placements)
        names["agents"] = {
            name: list(self._lookup(("agents", asked.role, asked.capabilities), f"agents.{name}"))
            for name, asked in choice.application.agents.items()
        }
        self._links = choice.application.links
        placed = self._add_services(choice.application, names)
        for number, link in enumerate(choice.application.links):
            if link.kind != "ros":
                index.bridge(link.kind)
                self._add_link(link, f"spec.links[{number}]", names, placed)
        for end in self._expansion.topics.ends:
            self._publish(end[1], filter(is_one_publishers, self._expansion.topics.names(end, IN)), end)
        self._expansion.choices = choices_of(self._expansion.choice_parts, self._expansion.groups)
        return self._expansion

    def _add_services(self, application: Any, names: Mapping[str, Any]) -> dict[str, list[PlacedInstance]]:
        """Place every service and make its releases; the instances of each of them, where they were placed."""
        every = instances(application, names, self._render)
        together = groups(every, application.links)
        bridged = [link for link in application.links if link.kind != "ros"]
        linked = any("service" in end for link in bridged for end in (link.source, link.target))
        group_of: dict[int, int] = {}
        charts: dict[int, Chosen] = {}
        placed: dict[str, list[PlacedInstance]] = {}
        for number, instance in enumerate(every):
            if number not in group_of:
                members = together[number]
                group_of.update(dict.fromkeys(members, len(self._expansion.groups)))
                charts.update(zip(members, self._place([every[member] for member in members]), strict=True))
            agent = self._expansion.groups[group_of[number]].placement.agent
            release = self._add_service(instance, agent, charts[number], group_of[number])
            opening = self._opening(instance, agent, charts[number][0], release) if linked else None
            placed.setdefault(instance.service.name, []).append(PlacedInstance(agent, instance.loop, opening))
        return placed

    def _place(self, members: Sequence[Instance]) -> list[Chosen]:
        """Place a group, and write it down; the charts of its members."""
        names = [self._render(member.service.release, member.scope) for member in members]
        charts, requests = [], []
        for member, name in zip(members, names, strict=True):
            chosen, request = self._request(member, name)
            charts.append(chosen)
            requests.append(request)
        part = _services(members)
        asked = self._asked(part, lambda: group(requests, self._index.fleet, self._demand.narrowing))
        placement = self._asked(part, lambda: self._assignments.assign(self._demand, asked, names, self._index))
        for member in members:
            self._placements.setdefault(member.service.name, placement.agent.name)
        self._expansion.groups.append(PlacedGroup(asked, tuple(names), placement))
        return charts

    def _request(self, instance: Instance, name: Any) -> tuple[Chosen, PlacementRequest]:
        service = instance.service
        kept = self._index.kept(self._demand, name)
        agent = self._render(service.placement.agent, instance.scope) if service.placement.agent else None
        part = f"service {service.name}"
        if agent is not None:
            self._lookup(("agent", agent), part)
        places = [agent] if isinstance(agent, str) else sorted(kept)
        keys = [f"{at.namespace}/{name}" for at in map(self._index.fleet.at.get, places) if at]
        pins = [(key, self._index.pins.get(key)) for key in keys]
        self._expansion.kept.append((name, kept))
        self._expansion.pins += pins
        pinned = next((pin for _, pin in pins if pin), None)
        role = "" if self._demand.roles else service.placement.role
        platforms = self._lookup(("platforms", agent if isinstance(agent, str) else "", role), part)
        chosen = self._index.selector.chart(service.chart, self._demand.requirements, platforms, pinned)
        chart = chosen[0]
        apart = f"{self._expansion.application}/{service.name}" if service.placement.spread else ""
        need = read_resources(chart.resources)
        asked = () if agent is not None else needs(self._links, instance, self._given, self._render)
        wanted = tuple(link_need for link_need in asked if link_need.binds)
        unfit = "" if self._index.selector.knows_guests(chart) else f"{chart.chart} {chart.version}"
        return chosen, PlacementRequest(
            service.name,
            service.placement,
            agent,
            kept,
            need,
            chart.platforms,
            apart,
            bool(service.unite),
            wanted,
            unfit,
        )

    def _lookup(self, lookup: Lookup, part: str) -> Any:
        """The fleet's answer, for a part of the application."""
        answer = self._asked(part, lambda: self._index.lookup(lookup))
        self._expansion.lookups.append((lookup, answer))
        return answer

    def _asked(self, part: str, ask: Callable[[], T]) -> T:
        """What `ask` gives; a refusal names the part of the application that it is for."""
        try:
            return ask()
        except RefusalError as error:
            text = f"{part} of application {self._expansion.application}: {error.message}"
            raise RefusalError(error.reason, text) from error

    def _opening(self, instance: Instance, agent: Agent, chart: ChartVersion, release: Release) -> Opening:
        """What an instance opens, by the entry of its chart and the values of its release."""
        topics = None
        if chart.interfaces:
            topics = opened(chart.interfaces, self._deployed(chart, release), self._render)
        return Opening(instance.service.name, chart.chart, agent.place, instance.loop, topics)

    def _deployed(self, chart: ChartVersion, release: Release) -> Mapping[str, Any]:
        return self._index.selector.deployed(chart, release.values)

    def _add_service(self, instance: Instance, agent: Agent, chosen: Chosen, group_number: int) -> Release:
        service = instance.service
        scope = instance.scope
        self._placements[service.name] = agent.name
        name = self._render(service.release, scope)
        expansion = self._expansion
        chart = chosen[0]
        movable = not expansion.groups[group_number].group.wanted.named
        its_chart = {"name": chart.chart, "version": chart.version, "digest": chart.digest}
        values = render_templates(service.values, {**scope, "chart": its_chart}, self._render)
        release = make_release(agent, name, chart, values, self._index, movable)
        for heard in heard_topics(values):
            self._hears(agent, said_as(heard.filter), f"service {service.name}")
        key = release.key
        if key in expansion.releases:
            raise RefusalError("CompositionFailed", f"two services of {expansion.application} make the release {key}")
        expansion.releases[key] = release
        expansion.merged_lists[key] = service.unite
        expansion.choice_parts += [(f"{service.name} -> {key}", *chosen[1]), group_number]
        if declares_topics(chart):
            topics = published_topics(chart, self._deployed(chart, release), self._render)
            self._publish(agent.place, topics, key)
        return release

    def _hears(self, agent: Agent, topic: str, part: str) -> None:
        """Note that an agent hears a topic, for a part of the application; RefusalError where it may not."""
        if self._index.fleet.has_borders:
            self._lookup(("heard", topic, agent.name), part)

    def _publish(self, place: str, topics: Iterable[str], publisher: Publisher) -> None:
        """Note what is published on a place; RefusalError when the application has two publishers of a topic there."""
        published = self._expansion.published
        for topic in topics:
            other = published.setdefault((place, topic), publisher)
            if other != publisher:
                raise RefusalError(
                    "CompositionFailed",
                    f"topic {topic} on {place} has two publishers in application {self._expansion.application}, "
                    f"{described(other)} and {described(publisher)}: who subscribes would get both mixed; give each "
                    "of them a topic of its own",
                )

    def _add_link(
        self, link: Link, path: str, names: Mapping[str, Any], placed: Mapping[str, Sequence[PlacedInstance]]
    ) -> None:
        topics = self._expansion.topics

        def agents(kind: str, name: Any) -> Sequence[Agent]:
            """An agent by name; every agent of a role that has a node."""
            return self._lookup((kind, name), path) if kind == "role" else [self._lookup(("end", name), path)]

        for passage in passages(link, names, placed, agents, self._render, path):
            if passage.target:
                self._hears(passage.target, passage.topic["name"], path)
            ends = [(end, way) for end, way in ((passage.source, OUT), (passage.target, IN)) if end]
            own = [(end, way) for end, way in ends if end.name in self._index.fleet.agents]
            if not own:  # nothing of it would be written here
                self._lookup(("agent", ends[0][0].name), path)
            for end, direction in own:
                topics.add(link.kind, end.place, direction, passage.topic, self._of_another_link)

    def _of_another_link(self, end: End, topic: str) -> str:
        """The words for who asked for a topic of a bridge already, within one application."""
        return f"for another link of application {self._expansion.application}"


def _services(members: Sequence[Instance]) -> str:
    names = list(dict.fromkeys(member.service.name for member in members))
    return f"{'services' if len(names) > 1 else 'service'} {', '.join(names)}"


def _names(demand: Demand, parameters: Mapping[str, Any], placements: dict[str, str]) -> dict[str, Any]:
    """The names that templates may use; `placement` grows while services are placed."""
    names: dict[str, Any] = {"parameters": parameters, "placement": placements}
    if demand.agent:
        names["agent"] = demand.agent
    if demand.task:
        task = demand.task
        names["task"] = {
            "name": task.name,
            "namespace": task.namespace,
            "event": task.event,
            "rule": task.rule,
            "trace": task.trace,
            "time": task.event_details.get("time", ""),
            "requester": task.requester,
        }
    return names


def make_release(
    agent: Agent, name: Any, chart: ChartVersion, values: Mapping[str, Any], index: Index, movable: bool = False
) -> Release:
    """A release without causes; RefusalError(CompositionFailed) or DocumentError when name or values cannot stand.
    `movable`: another agent could take it over."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise RefusalError("CompositionFailed", f"release name {name!r} must match {NAME.pattern}")
    application_name(agent.namespace, name)
    if agent.guest and not index.selector.knows_guests(chart):
        raise RefusalError(
            "NoCapableNode",
            f"{agent} {GUEST}, which {chart.chart} {chart.version} knows nothing of; publish a newer version, or give "
            "the agent a Node of its own",
        )
    placement: dict[str, Any] = {"agent": agent.name}
    placement |= {"node": agent.node} if agent.node else {}
    placement |= {"movable": True} if movable else {}
    placement |= {"guest": agent.guest} if agent.guest else {}
    full = {**values, "placement": placement}
    index.selector.check_values(chart, full, f"{agent.namespace}/{name}")
    evidence = index.selector.catalogue.evidence_of(chart)
    return Release(agent.namespace, name, chart.chart, chart.version, chart.digest, full, evidence=evidence)
