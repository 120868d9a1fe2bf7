"""Links of an application as a demand asks for them: which topics go from which agent to which.

A link repeats by its own `forEach`; without one, with those of the services at its ends. An instance of a service takes
part where it has the same values of the variables: with `forEach: {vehicle: ...}` at link and service, the topics of a
vehicle go to and from the instances of this vehicle only. What the broker would refuse is refused here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

from robotkube.delivery.manager.core.composition.co_location import Instance
from robotkube.delivery.manager.core.composition.publishers import refuse_too_long
from robotkube.delivery.manager.core.placement.link_needs import LinkNeed
from robotkube.delivery.manager.core.placement.placement import Agent
from robotkube.errors import DocumentError, RefusalError
from robotkube.foundation.documents.core.value_templates import Render, expand_for_each
from robotkube.registry.catalogue.core.applications import TOPIC_KEYS, TOPIC_KEYS_OPTIONAL, Link
from robotkube.registry.catalogue.core.links.ends import Opening, mismatches
from robotkube.registry.catalogue.core.links.loops import joined, loops_of
from robotkube.registry.catalogue.core.message_types.carried import bridged_type
from robotkube.robots.bridge.core.rights import IN, OUT, RULES, may

_KEYS = (*TOPIC_KEYS, *TOPIC_KEYS_OPTIONAL)

FindAgents = Callable[[str, Any], Sequence[Agent]]
"""The agents of an end, by its kind (`agent` or `role`) and the name there."""


@dataclass(frozen=True)
class PlacedInstance:
    """An instance of a service where it was placed; `loop` are the values of its `forEach` variables, `opening` what
    its chart opens there, None where nobody asks for that."""

    agent: Agent
    loop: Mapping[str, Any] = field(default_factory=dict)
    opening: Opening | None = None


@dataclass(frozen=True)
class Passage:
    """A topic that goes from one agent to another; None is the medium itself, where somebody else sends or receives."""

    source: Agent | None
    target: Agent | None
    topic: Mapping[str, Any]


def passages(
    link: Link,
    names: Mapping[str, Any],
    placed: Mapping[str, Sequence[PlacedInstance]],
    agents: FindAgents,
    render: Render,
    path: str = "spec.links",
) -> Iterator[Passage]:
    """Every topic of a link from every source to every target that is on another place: on one, ROS itself carries it.
    RefusalError when the broker would refuse one (LinkNotPermitted), no bridge knows its type (LinkTypeUnknown), or a
    chart at an end opens it otherwise (LinkMismatch). `path` is where the link stands in its application."""
    every = [placing.opening for placings in placed.values() for placing in placings if placing.opening]
    for scope, source, target in _legs(link, names, placed, render):
        sources = _ends(link.source, source, scope, agents, render)
        targets = _ends(link.target, target, scope, agents, render)
        rendered = [render(topic, scope) for topic in link.topics]
        for sender, receiver in product(sources, targets):
            if sender == receiver:
                continue
            for number, topic in enumerate(rendered):
                passage = Passage(sender, receiver, {key: topic[key] for key in _KEYS if key in topic})
                _check(passage)
                for key, text in mismatches(topic, _opening(source), _opening(target), every):
                    raise RefusalError("LinkMismatch", f"{path}.topics[{number}].{key}: {text}")
                yield passage


def needs(links: Sequence[Link], instance: Instance, names: Mapping[str, Any], render: Render) -> Iterator[LinkNeed]:
    """What the links of an instance ask of the agent on which it is placed, as far as that is known before: not of
    links to other services, nor of templates with a placement that is still to come."""
    for link in (one for one in links if one.kind != "ros"):
        for end, other, direction in ((link.source, link.target, OUT), (link.target, link.source, IN)):
            if end.get("service") != instance.service.name or "service" in other:
                continue
            try:
                yield from _needs(link, other, direction, instance, names, render)
            except DocumentError:
                continue


def _needs(
    link: Link,
    other: Mapping[str, str],
    direction: str,
    instance: Instance,
    names: Mapping[str, Any],
    render: Render,
) -> Iterator[LinkNeed]:
    for own in loops_of(link.for_each, names, render):
        if joined(own, instance.loop) is None:
            continue
        scope = {**names, **(own or instance.loop)}
        [(kind, text)] = other.items()
        end = {} if kind == "medium" else {kind: str(render(text, scope))}
        for topic in link.topics:
            yield LinkNeed(direction, str(render(topic["name"], scope)), **end)


def _legs(
    link: Link, names: Mapping[str, Any], placed: Mapping[str, Sequence[PlacedInstance]], render: Render
) -> Iterator[tuple[dict[str, Any], PlacedInstance | None, PlacedInstance | None]]:
    """The names for each repetition of a link, with the instances at its ends that take part in it."""
    for scope in expand_for_each(link.for_each, names, render):
        own = {variable: scope[variable] for variable in link.for_each}
        for source, target in product(_instances(link.source, placed), _instances(link.target, placed)):
            loop = joined(own, source.loop if source else {}, target.loop if target else {})
            if loop is not None:
                yield (scope if own else {**scope, **loop}), source, target


def _instances(
    end: Mapping[str, str], placed: Mapping[str, Sequence[PlacedInstance]]
) -> Sequence[PlacedInstance | None]:
    return placed.get(end["service"], ()) if "service" in end else (None,)


def _ends(
    end: Mapping[str, str],
    instance: PlacedInstance | None,
    scope: Mapping[str, Any],
    agents: FindAgents,
    render: Render,
) -> Sequence[Agent | None]:
    """An agent by name; every agent of a role that has a node; the agent of the instance; None for the medium."""
    if "medium" in end:
        return [None]
    if instance is not None:
        return [instance.agent]
    [(kind, name)] = end.items()
    return agents(kind, render(name, scope))


def _opening(instance: PlacedInstance | None) -> Opening | None:
    return instance.opening if instance else None


def _check(passage: Passage) -> None:
    name = passage.topic["name"]
    refuse_too_long(str(name), "a link")
    problem = bridged_type(str(passage.topic["type"]))
    if problem:
        raise RefusalError("LinkTypeUnknown", f"topic {name}: {problem}")
    for agent, direction in ((passage.source, OUT), (passage.target, IN)):
        if agent is not None and not may(agent, direction, name):
            verb = "write" if direction == OUT else "read"
            raise RefusalError(
                "LinkNotPermitted",
                f"topic {name} cannot go from {passage.source or 'the broker'} to {passage.target or 'the broker'}: "
                f"{agent.name} (role {agent.role}) may not {verb} it at the broker, where {RULES}. Let the agent that "
                "the topic is named after send it: by the topic's name, the placement of the application's services, "
                "or the task's placement.roles or placement.agents",
            )
