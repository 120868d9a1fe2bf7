"""Demands -> the releases that should exist, with reasons; a demand that cannot be met is refused and leaves no trace.

Services become releases; links of kind mqtt become topics of the bridge release at both ends, as the union over all
demands, so that no message crosses twice. The result does not depend on the order in which tasks are listed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from robotkube.domain.catalogue import Catalogue
from robotkube.domain.catalogue_applications import Link, Service
from robotkube.domain.catalogue_charts import ChartVersion
from robotkube.domain.errors import DocumentError, RefusalError
from robotkube.domain.loops import Render, fill, loop
from robotkube.domain.placement import Agent, Fleet, place
from robotkube.domain.releases import NAME, Cause, Release, application_name
from robotkube.domain.tasks import TaskDescription, with_defaults
from robotkube.domain.texts import json_problems

Validate = Callable[[Mapping[str, Any], Any], Sequence[str]]
"""Problems of a value under a JSON Schema."""

_Item = TypeVar("_Item", Service, Link)
OUT, IN = "out", "in"
TOPIC_KEYS = ("name", "type", "channel", "reliability", "durability", "depth")


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
    """What one demand (or all so far) asks for: releases by key, topics by (kind, agent, direction) and name."""

    releases: dict[str, Release] = field(default_factory=dict)
    owners: dict[str, list[Demand]] = field(default_factory=dict)
    topics: dict[tuple[str, str, str], dict[str, Mapping[str, Any]]] = field(default_factory=dict)
    topic_owners: dict[tuple[str, str], list[Demand]] = field(default_factory=dict)
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
    owners = {key: [demand] for key in draft.owners}
    topic_owners = {key: [demand] for key in draft.topic_owners}
    return replace(draft, owners=owners, topic_owners=topic_owners, choices=[f"shares the releases of {owner.key}"])


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
    placed: dict[str, list[Agent]] = {}
    for service, scope in _instances(application.services, names, world.render):
        _add_service(service, scope, demand, world, total, draft, placed)
    for link, scope in _instances(application.links, names, world.render):
        world.catalogue.select(_bridge_service(link.kind, world).chart)
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


def _instances(
    items: Iterable[_Item], names: Mapping[str, Any], render: Render
) -> Iterator[tuple[_Item, dict[str, Any]]]:
    for item in items:
        for scope in loop(item.for_each, names, render):
            yield item, scope


def _add_service(
    service: Service,
    scope: dict[str, Any],
    demand: Demand,
    world: World,
    total: _Draft,
    draft: _Draft,
    placed: dict[str, list[Agent]],
) -> None:
    chart, chart_reasons = world.catalogue.select(service.chart)
    name = world.render(service.release, scope)
    rule = replace(service.placement, agent=world.render(service.placement.agent, scope))
    placement = place(rule, world.fleet, _kept(name, demand, world), _load(world.fleet, total, draft))
    scope["placement"][service.name] = placement.agent.name
    placed.setdefault(service.name, []).append(placement.agent)
    release = _release(placement.agent, name, chart, fill(service.values, scope, world.render))
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


def _release(agent: Agent, name: Any, chart: ChartVersion, values: Mapping[str, Any]) -> Release:
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise RefusalError("CompositionFailed", f"release name {name!r} must match {NAME.pattern}")
    application_name(agent.namespace, name)
    full = {**values, "placement": {"agent": agent.name}}
    problems = json_problems(full, "values")
    if problems:
        raise RefusalError("CompositionFailed", "; ".join(problems))
    return Release(agent.namespace, name, chart.chart, chart.version, chart.digest, full)


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
                _add_topic(draft, (link.kind, source.name, OUT), topic, demand)
                _add_topic(draft, (link.kind, target.name, IN), topic, demand)


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


def _add_topic(draft: _Draft, end: tuple[str, str, str], topic: Mapping[str, Any], demand: Demand) -> None:
    topics = draft.topics.setdefault(end, {})
    _same_topic(end, topics.get(topic["name"]), topic)
    kind, agent, direction = end
    if topic["name"] in draft.topics.get((kind, agent, IN if direction == OUT else OUT), {}):
        raise RefusalError(
            "CompositionFailed", f"topic {topic['name']} would leave and enter {agent} by its bridge: a loop"
        )
    topics[topic["name"]] = topic
    owners = draft.topic_owners.setdefault((kind, agent), [])
    if demand not in owners:
        owners.append(demand)


def _same_topic(end: tuple[str, str, str], present: Mapping[str, Any] | None, topic: Mapping[str, Any]) -> None:
    if present is None or present == topic:
        return
    differences = ", ".join(f"{k} {present[k]!r} and {topic[k]!r}" for k in TOPIC_KEYS if present[k] != topic[k])
    raise RefusalError(
        "CompositionFailed", f"topic {topic['name']} at the bridge of {end[1]} is asked for with {differences}"
    )


def _merge(total: _Draft, draft: _Draft) -> None:
    """Take `draft` into `total`, or raise and leave `total` as it was."""
    for key, release in draft.releases.items():
        if key in total.releases and total.releases[key] != release:
            names = ", ".join(owner.key for owner in total.owners[key])
            raise RefusalError("CompositionFailed", f"release {key} is made by {names} with other content")
    trial = {end: dict(topics) for end, topics in total.topics.items()}
    merged = _Draft(topics=trial, topic_owners={key: list(owners) for key, owners in total.topic_owners.items()})
    for end, topics in draft.topics.items():
        for topic in topics.values():
            for owner in draft.topic_owners[end[0], end[1]]:
                _add_topic(merged, end, topic, owner)
    total.topics, total.topic_owners = merged.topics, merged.topic_owners
    total.releases.update(draft.releases)
    for key, owners in draft.owners.items():
        total.owners.setdefault(key, []).extend(owners)


def _finish(total: _Draft, outcomes: Mapping[str, Any], world: World) -> Desired:
    """Add the bridges, write every release's causes, and name each demand's releases."""
    releases, owners = dict(total.releases), dict(total.owners)
    bridge_keys: dict[tuple[str, str], str] = {}
    for (kind, agent), bridge_owners in sorted(total.topic_owners.items()):
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
    keys = {*outcome.owners, *(bridge_keys[end] for end in outcome.topic_owners)}
    return Met(tuple(sorted(keys)), tuple(outcome.choices))


def _causes(owners: Iterable[Demand]) -> tuple[Cause, ...]:
    return tuple(sorted({cause for owner in owners for cause in owner.causes}))


def _bridge(kind: str, agent: str, total: _Draft, world: World) -> Release:
    service = _bridge_service(kind, world)
    chart, _ = world.catalogue.select(service.chart)
    names = {"agent": agent, "topics": {d: _sorted(total.topics.get((kind, agent, d), {})) for d in (OUT, IN)}}
    name = world.render(service.release, names)
    return _release(world.fleet.agent(agent), name, chart, fill(service.values, names, world.render))


def _bridge_service(kind: str, world: World) -> Service:
    application = world.catalogue.bridge(kind)
    if len(application.services) != 1:
        raise RefusalError("CompositionFailed", f"bridge application {application.name} must have exactly one service")
    return application.services[0]


def _sorted(topics: Mapping[str, Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    return [topics[name] for name in sorted(topics)]
