"""Demands -> the releases that should exist, with reasons; a demand that cannot be met is refused and leaves no trace.

Services become releases; services with links of kind ros share a node; links of kind mqtt become topics of the bridge
release at both ends, as the union over all demands, so that no message crosses twice. The result does not depend on the
order in which tasks are listed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from robotkube.domain.catalogue import Catalogue
from robotkube.domain.catalogue_applications import TOPIC_KEYS, Application, Link, Service
from robotkube.domain.catalogue_charts import ChartVersion
from robotkube.domain.errors import DocumentError, RefusalError
from robotkube.domain.grouping import Instance, groups, instances
from robotkube.domain.loops import Render, fill, loop
from robotkube.domain.placement import Agent, Fleet, Placement, Seat, place
from robotkube.domain.releases import NAME, Cause, Release, application_name
from robotkube.domain.tasks import TaskDescription, with_defaults
from robotkube.domain.texts import json_problems
from robotkube.domain.topic_unions import IN, OUT, TopicUnion

Validate = Callable[[Mapping[str, Any], Any], Sequence[str]]
"""Problems of a value under a JSON Schema."""


@dataclass(frozen=True)
class Demand:
    """One reason for an application to run: a task, or the initial configuration of one agent."""

    key: str
    application: str
    parameters: Mapping[str, Any]
    agent: str = ""
    task: TaskDescription | None = None

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The task's cause; nothing for the initial configuration."""
        return (self.task.cause,) if self.task else ()

    @property
    def shared_key(self) -> str:
        """Equal for demands that one set of releases answers."""
        return repr((self.application, self.agent, sorted(self.parameters.items(), key=lambda item: item[0])))


@dataclass(frozen=True)
class Refused:
    """Why a demand is not met: a reason of the closed list, and the sentence for people."""

    reason: str
    message: str


@dataclass(frozen=True)
class Met:
    """How a demand is met: the releases (`<namespace>/<name>`) and every choice in words."""

    releases: tuple[str, ...]
    choices: tuple[str, ...]


@dataclass(frozen=True)
class Desired:
    """The whole answer: releases by path, an outcome per demand key, the paths the initial configuration uses."""

    releases: Mapping[str, Release]
    outcomes: Mapping[str, Met | Refused]
    initial: frozenset[str] = frozenset()


@dataclass(frozen=True)
class World:
    """Everything composition looks at. `present` are main's releases by path."""

    catalogue: Catalogue
    fleet: Fleet
    present: Mapping[str, Release]
    render: Render
    validate: Validate


@dataclass
class _Draft:
    """What one demand (or all so far) asks for: releases by key, and topics of the bridges."""

    releases: dict[str, Release] = field(default_factory=dict)
    owners: dict[str, list[Demand]] = field(default_factory=dict)
    topics: TopicUnion[Demand] = field(default_factory=TopicUnion)
    choices: list[str] = field(default_factory=list)


def compose(demands: Iterable[Demand], world: World) -> Desired:
    """Meet the demands, those of the initial configuration first, then tasks by creation time and name."""
    total = _Draft()
    outcomes: dict[str, _Draft | Refused] = {}
    first: dict[str, tuple[Demand, _Draft]] = {}
    for demand in sorted(demands, key=_order):
        try:
            if demand.shared_key in first:
                draft = _joined(demand, *first[demand.shared_key])
            else:
                draft = _draft(demand, world, total)
                first[demand.shared_key] = (demand, draft)
            _merge(total, draft)
            outcomes[demand.key] = draft
        except RefusalError as error:
            outcomes[demand.key] = Refused(error.reason, error.message)
            first.pop(demand.shared_key, None)
        except DocumentError as error:
            outcomes[demand.key] = Refused("CompositionFailed", str(error))
            first.pop(demand.shared_key, None)
    return _finish(total, outcomes, world)


def _order(demand: Demand) -> tuple[bool, str, str]:
    return demand.task is not None, demand.task.created if demand.task else "", demand.key


def _joined(demand: Demand, owner: Demand, draft: _Draft) -> _Draft:
    """The releases of an equal earlier demand, shared."""
    owners, topics = {key: [demand] for key in draft.owners}, draft.topics.owned_by(demand)
    return replace(draft, owners=owners, topics=topics, choices=[f"shares the releases of {owner.key}"])


def _draft(demand: Demand, world: World, total: _Draft) -> _Draft:
    application = world.catalogue.applications.get(demand.application)
    if application is None:
        known = ", ".join(sorted(world.catalogue.applications)) or "nothing"
        raise RefusalError(
            "UnknownApplication", f"the catalogue has no application {demand.application!r}; it has {known}"
        )
    parameters = with_defaults(application.parameters, demand.parameters)
    problems = world.validate(application.parameters, parameters)
    if problems:
        raise RefusalError("InvalidParameters", "; ".join(problems))
    draft = _Draft()
    names = _names(demand, parameters)
    placed = _add_services(application, names, demand, world, total, draft)
    for link in application.links:
        if link.kind != "ros":
            world.catalogue.select(_bridge_service(link.kind, world).chart)
            for scope in loop(link.for_each, names, world.render):
                _add_link(link, scope, demand, world, draft, placed)
    return draft


def _names(demand: Demand, parameters: Mapping[str, Any]) -> dict[str, Any]:
    names: dict[str, Any] = {"parameters": parameters, "placement": {}}
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


def _add_services(
    application: Application, names: Mapping[str, Any], demand: Demand, world: World, total: _Draft, draft: _Draft
) -> dict[str, list[Agent]]:
    """Draft every service; the agents on which each of them was placed."""
    found = instances(application, names, world.render)
    together = groups(found, application.links)
    placements: dict[int, Placement] = {}
    placed: dict[str, list[Agent]] = {}
    for index, instance in enumerate(found):
        if index not in placements:
            group = [found[member] for member in together[index]]
            placement = place([_seat(i, demand, world) for i in group], world.fleet, _load(world.fleet, total, draft))
            placements.update(dict.fromkeys(together[index], placement))
            for member in group:
                member.scope["placement"].setdefault(member.service.name, placement.agent.name)
        _add_service(instance, placements[index], demand, world, draft)
        placed.setdefault(instance.service.name, []).append(placements[index].agent)
    return placed


def _seat(instance: Instance, demand: Demand, world: World) -> Seat:
    service, scope = instance.service, instance.scope
    kept = _kept(world.render(service.release, scope), demand, world)
    agent = world.render(service.placement.agent, scope) if service.placement.agent else None
    return Seat(service.name, service.placement, agent, kept)


def _add_service(instance: Instance, placement: Placement, demand: Demand, world: World, draft: _Draft) -> None:
    service, scope = instance.service, instance.scope
    chart, chart_reasons = world.catalogue.select(service.chart)
    scope["placement"][service.name] = placement.agent.name
    name = world.render(service.release, scope)
    release = _release(placement.agent, name, chart, fill(service.values, scope, world.render), world)
    if release.key in draft.releases:
        raise RefusalError("CompositionFailed", f"two services of {demand.application} make the release {release.key}")
    draft.releases[release.key] = release
    draft.owners[release.key] = [demand]
    draft.choices += [f"{service.name} -> {release.key}", *chart_reasons, *placement.reasons]


def _kept(name: Any, demand: Demand, world: World) -> frozenset[str]:
    """Agents on which this demand's release runs already."""
    tasks = {cause.task for cause in demand.causes}
    found = (r for r in world.present.values() if r.name == name)
    namespaces = {r.namespace for r in found if not tasks or tasks & {c.task for c in r.causes}}
    return frozenset(a.name for a in world.fleet.agents.values() if a.namespace in namespaces)


def _load(fleet: Fleet, *drafts: _Draft) -> dict[str, int]:
    namespaces = [release.namespace for draft in drafts for release in draft.releases.values()]
    return {agent.name: namespaces.count(agent.namespace) for agent in fleet.agents.values()}


def _release(agent: Agent, name: Any, chart: ChartVersion, values: Mapping[str, Any], world: World) -> Release:
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise RefusalError("CompositionFailed", f"release name {name!r} must match {NAME.pattern}")
    application_name(agent.namespace, name)
    full = {**values, "placement": {"agent": agent.name}}
    problems = json_problems(full, "values")
    if problems:
        raise RefusalError("CompositionFailed", "; ".join(problems))
    evidence = world.catalogue.evidence_of(chart)
    return Release(agent.namespace, name, chart.chart, chart.version, chart.digest, full, evidence=evidence)


def _add_link(
    link: Link, scope: dict[str, Any], demand: Demand, world: World, draft: _Draft, placed: Mapping[str, list[Agent]]
) -> None:
    sources = _ends(link.source, scope, world, placed)
    targets = _ends(link.target, scope, world, placed)
    topics = [_topic(world.render(topic, scope)) for topic in link.topics]
    for source in sources:
        for target in targets:
            if source == target:
                continue  # both ends on one node: ROS itself carries the topic
            for topic in topics:
                draft.topics.add(link.kind, source.name, OUT, topic, demand)
                draft.topics.add(link.kind, target.name, IN, topic, demand)


def _ends(
    end: Mapping[str, str], scope: Mapping[str, Any], world: World, placed: Mapping[str, list[Agent]]
) -> Sequence[Agent]:
    """An agent by name; every agent of a role that has a node; the agents a service was placed on."""
    if "service" in end:
        return placed.get(end["service"], [])
    if "role" in end:
        return world.fleet.present(world.render(end["role"], scope))
    return [world.fleet.agent(world.render(end["agent"], scope))]


def _topic(value: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value[key] for key in TOPIC_KEYS}


def _merge(total: _Draft, draft: _Draft) -> None:
    """Take `draft` into `total`, or raise and leave `total` as it was."""
    for key, release in draft.releases.items():
        if key in total.releases and total.releases[key] != release:
            names = ", ".join(owner.key for owner in total.owners[key])
            raise RefusalError("CompositionFailed", f"release {key} is made by {names} with other content")
    total.topics = total.topics.merged(draft.topics)
    total.releases.update(draft.releases)
    for key, owners in draft.owners.items():
        total.owners.setdefault(key, []).extend(owners)


def _finish(total: _Draft, outcomes: Mapping[str, Any], world: World) -> Desired:
    """Add the bridges, write every release's causes, and name each demand's releases."""
    releases, owners = dict(total.releases), dict(total.owners)
    bridge_keys: dict[tuple[str, str], str] = {}
    for (kind, agent), bridge_owners in sorted(total.topics.owners.items()):
        release = _bridge(kind, agent, total, world)
        bridge_keys[kind, agent] = release.key
        releases[release.key], owners[release.key] = release, bridge_owners
    final = {r.path: replace(r, causes=_causes(owners[key])) for key, r in releases.items()}
    initial = frozenset(r.path for key, r in releases.items() if any(o.task is None for o in owners[key]))
    met = {key: _outcome(outcome, bridge_keys) for key, outcome in outcomes.items()}
    return Desired(final, met, initial)


def _outcome(outcome: _Draft | Refused, bridge_keys: Mapping[tuple[str, str], str]) -> Met | Refused:
    if isinstance(outcome, Refused):
        return outcome
    keys = {*outcome.owners, *(bridge_keys[end] for end in outcome.topics.owners)}
    return Met(tuple(sorted(keys)), tuple(outcome.choices))


def _causes(owners: Iterable[Demand]) -> tuple[Cause, ...]:
    return tuple(sorted({cause for owner in owners for cause in owner.causes}))


def _bridge(kind: str, agent: str, total: _Draft, world: World) -> Release:
    service = _bridge_service(kind, world)
    chart, _ = world.catalogue.select(service.chart)
    names = {"agent": agent, "topics": total.topics.at(kind, agent)}
    name = world.render(service.release, names)
    return _release(world.fleet.agent(agent), name, chart, fill(service.values, names, world.render), world)


def _bridge_service(kind: str, world: World) -> Service:
    application = world.catalogue.bridge(kind)
    if len(application.services) != 1:
        raise RefusalError("CompositionFailed", f"bridge application {application.name} must have exactly one service")
    return application.services[0]
