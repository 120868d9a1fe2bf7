"""What one demand asks for: releases on agents, and topics of bridges. Drafted once, then seated again and again.

A draft is everything that rendering and validating gave. It stays good as long as every group of services is placed on
the same agents as when it was drafted, so composing again only asks where they go.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from robotkube.domain.capacities import Resources, read_resources
from robotkube.domain.catalogue import Pin
from robotkube.domain.catalogue_applications import TOPIC_KEYS, Link
from robotkube.domain.catalogue_charts import ChartVersion
from robotkube.domain.errors import RefusalError
from robotkube.domain.grouping import Instance, groups, instances
from robotkube.domain.loops import fill, loop
from robotkube.domain.placement import Agent, Fleet, Group, Placement, Seat, group
from robotkube.domain.releases import NAME, Cause, Release, application_name
from robotkube.domain.scenes import Question, Scene
from robotkube.domain.seating import Seating
from robotkube.domain.selection import Chosen
from robotkube.domain.topic_unions import IN, OUT, TopicUnion
from robotkube.domain.worlds import Demand


@dataclass(frozen=True)
class Step:
    """One group that was placed: its releases' names, what each asks for, and where it went."""

    group: Group
    names: tuple[Any, ...]
    needs: tuple[Resources, ...]
    placement: Placement


@dataclass
class Draft:
    """What a demand asks for. `agents` and `needs` go by release key; `unite` are values paths whose lists are united
    when another demand makes the same release; `questions` and `pins` are what it depends on beside the catalogue."""

    demand: Demand
    application: str
    cause: Cause | None
    releases: dict[str, Release] = field(default_factory=dict)
    agents: dict[str, str] = field(default_factory=dict)
    needs: dict[str, Resources] = field(default_factory=dict)
    unite: dict[str, tuple[str, ...]] = field(default_factory=dict)
    topics: TopicUnion = field(default_factory=TopicUnion)
    steps: list[Step] = field(default_factory=list)
    words: list[tuple[str, ...] | int] = field(default_factory=list)
    questions: list[tuple[Question, Any]] = field(default_factory=list)
    pins: list[tuple[str, Pin | None]] = field(default_factory=list)
    choices: tuple[str, ...] = ()
    fleet: Fleet | None = None


def choices_of(words: Sequence[tuple[str, ...] | int], steps: Sequence[Step]) -> tuple[str, ...]:
    """Every choice in words: texts as they are, and the reasons of the step with that number."""
    parts = [(steps[word].placement.reasons if isinstance(word, int) else word) for word in words]
    return tuple(text for part in parts for text in part)


class Drafter:
    """Drafts one demand in a scene."""

    def __init__(self, demand: Demand, scene: Scene, seating: Seating) -> None:
        self._demand, self._scene, self._seating = demand, scene, seating
        self._render = scene.render
        self._placements: dict[str, str] = {}

    def draft(self) -> Draft:
        """Everything that the demand asks for; RefusalError or DocumentError when it cannot be met."""
        demand, scene = self._demand, self._scene
        choice = scene.selector.application(demand, scene.kept_application(demand))
        cause = replace(demand.task.cause, application=choice.application.name) if demand.task else None
        self._draft = Draft(demand, choice.application.name, cause, words=[choice.reasons], fleet=scene.fleet)
        names = _names(demand, choice.parameters, self._placements)
        placed = self._add_services(choice.application, names)
        for link in choice.application.links:
            if link.kind != "ros":
                scene.selector.bridge(link.kind)
                for scope in loop(link.for_each, names, self._render):
                    self._add_link(link, scope, placed)
        self._draft.choices = choices_of(self._draft.words, self._draft.steps)
        return self._draft

    def _add_services(self, application: Any, names: Mapping[str, Any]) -> dict[str, list[Agent]]:
        """Draft every service; the agents on which each of them was placed."""
        found = instances(application, names, self._render)
        together = groups(found, application.links)
        steps: dict[int, int] = {}
        charts: dict[int, Chosen] = {}
        placed: dict[str, list[Agent]] = {}
        for index, instance in enumerate(found):
            if index not in steps:
                members = together[index]
                steps.update(dict.fromkeys(members, len(self._draft.steps)))
                charts.update(zip(members, self._place([found[member] for member in members]), strict=True))
            agent = self._draft.steps[steps[index]].placement.agent
            self._add_service(instance, agent, charts[index], steps[index])
            placed.setdefault(instance.service.name, []).append(agent)
        return placed

    def _place(self, members: Sequence[Instance]) -> list[Chosen]:
        """Place a group, and write down the step; the charts of its members."""
        names = [self._render(member.service.release, member.scope) for member in members]
        charts, seats = [], []
        for member, name in zip(members, names, strict=True):
            chosen, seat = self._seat(member, name)
            charts.append(chosen)
            seats.append(seat)
        asked = group(seats, self._scene.fleet, self._demand.narrowing)
        needs = tuple(seat.need for seat in seats)
        placement = self._seating.seat(self._demand, asked, names, needs, self._scene)
        for member in members:
            self._placements.setdefault(member.service.name, placement.agent.name)
        self._draft.steps.append(Step(asked, tuple(names), needs, placement))
        return charts

    def _seat(self, instance: Instance, name: Any) -> tuple[Chosen, Seat]:
        service = instance.service
        kept = self._scene.kept(self._demand, name)
        agent = self._render(service.placement.agent, instance.scope) if service.placement.agent else None
        if agent is not None:
            self._ask(("agent", agent))
        places = [agent] if isinstance(agent, str) else sorted(kept)
        keys = [f"{a.namespace}/{name}" for a in map(self._scene.fleet.at.get, places) if a]
        self._draft.pins += [(key, self._scene.pins.get(key)) for key in keys]
        pinned = next((pin for key in keys if (pin := self._scene.pins.get(key))), None)
        role = "" if self._demand.roles else service.placement.role
        platforms = self._ask(("platforms", agent if isinstance(agent, str) else "", role))
        chosen = self._scene.selector.chart(service.chart, self._demand.requirements, platforms, pinned)
        chart = chosen[0]
        apart = f"{self._draft.application}/{service.name}" if service.placement.spread else ""
        need = read_resources(chart.resources)
        return chosen, Seat(
            service.name, service.placement, agent, kept, need, chart.platforms, apart, bool(service.unite)
        )

    def _ask(self, question: Question) -> Any:
        answer = self._scene.answer(question)
        self._draft.questions.append((question, answer))
        return answer

    def _add_service(self, instance: Instance, agent: Agent, chosen: Chosen, step: int) -> None:
        service, scope = instance.service, instance.scope
        self._placements[service.name] = agent.name
        name = self._render(service.release, scope)
        draft, chart = self._draft, chosen[0]
        movable = not self._draft.steps[step].group.wanted.named
        its_chart = {"name": chart.chart, "version": chart.version, "digest": chart.digest}
        values = fill(service.values, {**scope, "chart": its_chart}, self._render)
        release = make_release(agent, name, chart, values, self._scene, movable)
        key = release.key
        if key in draft.releases:
            raise RefusalError("CompositionFailed", f"two services of {draft.application} make the release {key}")
        draft.releases[key], draft.agents[key] = release, agent.name
        draft.needs[key], draft.unite[key] = read_resources(chart.resources), service.unite
        draft.words += [(f"{service.name} -> {key}", *chosen[1]), step]

    def _add_link(self, link: Link, scope: Mapping[str, Any], placed: Mapping[str, list[Agent]]) -> None:
        sources, targets = self._ends(link.source, scope, placed), self._ends(link.target, scope, placed)
        topics = [{key: found[key] for key in TOPIC_KEYS} for found in (self._render(t, scope) for t in link.topics)]
        for source in sources:
            for target in targets:
                if source == target:
                    continue  # both ends on one node: ROS itself carries the topic
                for topic in topics:
                    if source:
                        self._draft.topics.add(link.kind, source.place, OUT, topic)
                    if target:
                        self._draft.topics.add(link.kind, target.place, IN, topic)

    def _ends(
        self, end: Mapping[str, str], scope: Mapping[str, Any], placed: Mapping[str, list[Agent]]
    ) -> Sequence[Agent | None]:
        """An agent by name; every agent of a role that has a node; the agents a service was placed on; None for the
        medium itself, where somebody else than an agent takes or gives the topics."""
        if "medium" in end:
            return [None]
        if "service" in end:
            return placed.get(end["service"], [])
        if "role" in end:
            found: Sequence[Agent] = self._ask(("role", self._render(end["role"], scope)))
            return found
        return [self._ask(("agent", self._render(end["agent"], scope)))]


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
    agent: Agent, name: Any, chart: ChartVersion, values: Mapping[str, Any], scene: Scene, movable: bool = False
) -> Release:
    """A release without causes; RefusalError(CompositionFailed) or DocumentError when name or values cannot stand.
    `movable`: another agent could take it over."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise RefusalError("CompositionFailed", f"release name {name!r} must match {NAME.pattern}")
    application_name(agent.namespace, name)
    placement: dict[str, Any] = {"agent": agent.name}
    placement |= {"node": agent.node} if agent.node else {}
    placement |= {"movable": True} if movable else {}
    full = {**values, "placement": placement}
    scene.selector.check_values(chart, full)
    evidence = scene.selector.catalogue.evidence_of(chart)
    return Release(agent.namespace, name, chart.chart, chart.version, chart.digest, full, evidence=evidence)
