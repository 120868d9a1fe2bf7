"""Scopes of a manager, and of an operator within it: namespaces whose tasks it answers, agents, applications.

A manager plans for its own agents only, and leaves every release of other agents as it is on main. An agent belongs to
exactly one manager, so every bridge has one author, and no topic two publishers on a node. An operator is the author of
the tasks in one namespace; its scope is never more than its manager's, and in a chain never more than its parent's.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

from robotkube.delivery.deployment.core.borders import Borders, scopes_of
from robotkube.delivery.deployment.core.policies.links import LinkConsents
from robotkube.delivery.deployment.core.releases import Release, Source
from robotkube.delivery.manager.core.placement.placement import Agent, Fleet, NodeState
from robotkube.delivery.tasks.core.task_description import LINK_NOT_CONSENTED
from robotkube.errors import RefusalError
from robotkube.foundation.documents.core.patterns import ALL

OUTSIDE_SCOPE = "OutsideScope"
PLATFORM = "platform"
VALUES = "(charts/robotkube, values managers)"
EVERYTHING = frozenset({ALL})


@dataclass(frozen=True)
class Scope:
    """A scope as names, or `*` for all: `namespaces` of tasks, `agents` whose releases may change, `applications`."""

    namespaces: frozenset[str] = EVERYTHING
    agents: frozenset[str] = EVERYTHING
    applications: frozenset[str] = EVERYTHING

    def covers_namespace(self, name: str) -> bool:
        """Return whether tasks of this namespace belong to it."""
        return _covers(self.namespaces, name)

    def covers_agent(self, name: str) -> bool:
        """Return whether releases on this agent belong to it."""
        return _covers(self.agents, name)

    def covers_application(self, name: str) -> bool:
        """Return whether its tasks may ask for this application."""
        return _covers(self.applications, name)

    def subset(self, other: Scope) -> bool:
        """Return whether nothing is in it that is not in `other`."""
        pairs = zip(self._parts(), other._parts(), strict=True)
        return all(ALL in others or (ALL not in own and own <= others) for own, others in pairs)

    def narrowed(self, other: Scope) -> Scope:
        """The intersection of both scopes."""
        return Scope(*(_both(mine, theirs) for mine, theirs in zip(self._parts(), other._parts(), strict=True)))

    @property
    def named_namespaces(self) -> frozenset[str]:
        """The namespaces by name; none for all."""
        return frozenset() if ALL in self.namespaces else self.namespaces

    @property
    def is_narrow(self) -> bool:
        """Return whether there are agents outside of it."""
        return ALL not in self.agents

    def _parts(self) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
        return self.namespaces, self.agents, self.applications


def _covers(names: Collection[str], name: str) -> bool:
    return ALL in names or name in names


def _both(mine: frozenset[str], theirs: frozenset[str]) -> frozenset[str]:
    if ALL in mine:
        return theirs
    return mine if ALL in theirs else mine & theirs


ANYTHING = Scope()


@dataclass(frozen=True)
class DeclaredManager:
    """One of the managers of an installation: the name of its account, and its scope."""

    name: str
    scope: Scope


@dataclass(frozen=True)
class Operators:
    """The scope of a manager, and the scopes declared for operators: namespace of their tasks -> agents and
    applications (`namespaces` of these is not used). `managers` are all of the installation."""

    manager: Scope = field(default_factory=Scope)
    declared: Mapping[str, Scope] = field(default_factory=dict)
    managers: tuple[DeclaredManager, ...] = ()

    @property
    def unbounded(self) -> bool:
        """Return whether every task may ask for everything."""
        return not self.declared and ANYTHING.subset(self.manager)

    def scope(self, namespaces: Sequence[str]) -> Scope:
        """The scope of a task whose chain comes through these namespaces, its own included: never more than any
        operator of the chain may."""
        scope = self.manager
        for namespace in namespaces:
            declared = self.declared.get(namespace)
            if declared is not None:
                scope = scope.narrowed(Scope(EVERYTHING, declared.agents, declared.applications))
        return scope

    def borders(self, consents: LinkConsents) -> Borders:
        """The borders between the managers' scopes, and what main lets pass them."""
        return Borders(scopes_of((manager.name, manager.scope.agents) for manager in self.managers), consents)


def overlaps(managers: Sequence[DeclaredManager]) -> list[str]:
    """Overlaps of managers, in agents or namespaces: a sentence for each pair, with both names and the way out."""
    sentences = []
    for one, other in combinations(managers, 2):
        parts = {"agents": (one.scope.agents, other.scope.agents)}
        parts["namespaces"] = (one.scope.namespaces, other.scope.namespaces)
        for key, (mine, theirs) in parts.items():
            if both := _both(mine, theirs):
                sentences.append(
                    f"managers {one.name!r} and {other.name!r} both have {_listed(both)} in scope.{key}: a release "
                    f"would have two authors, a bridge two publishers; name each in one manager only {VALUES}"
                )
    return sentences


def left_out(managers: Sequence[DeclaredManager], agents: Iterable[str]) -> list[str]:
    """The agents that no manager answers for: a sentence for each, with the way out."""
    return [
        f"agent {name!r} is in no manager's scope, so nothing would ever run on it; add it to scope.agents and "
        f"scope.namespaces of one of {', '.join(manager.name for manager in managers)} {VALUES}"
        for name in agents
        if not any(manager.scope.covers_agent(name) for manager in managers)
    ]


def split_agents(scope: Scope, agents: Iterable[str]) -> list[str]:
    """The agents whose namespace is another manager's, or the other way round: a sentence for each, with the way
    out. What an operator on such an agent asked for would be answered by a manager that may not touch it."""
    sentences = []
    for name in agents:
        agent = scope.covers_agent(name)
        namespace = scope.covers_namespace(name)
        if agent != namespace:
            there, missing = ("agents", "namespaces") if agent else ("namespaces", "agents")
            sentences.append(
                f"{name!r} is in scope.{there}, but not in scope.{missing}: operators launched there would have "
                f"another manager; name it in both {VALUES}"
            )
    return sentences


def excesses(manager: Scope, declared: Mapping[str, Mapping[str, frozenset[str]]]) -> list[str]:
    """The declared operators that are not the manager's, or are given more than it has: a sentence each, with the way
    out. `declared`: namespace of its tasks -> the names given for agents and applications."""
    sentences = []
    whole = {"agents": manager.agents, "applications": manager.applications}
    for namespace, given in declared.items():
        if not manager.covers_namespace(namespace):
            sentences.append(
                f"operator {namespace!r} is not in scope.namespaces: declare it at the manager that answers it, or add "
                f"the namespace {VALUES}"
            )
        for key, names in given.items():
            if ALL not in whole[key] and (more := names - whole[key]):
                sentences.append(
                    f"operator {namespace!r} has {_listed(more)} in {key}, more than its manager's scope.{key}: an "
                    f"operator may never do more than its manager; take it out {VALUES}"
                )
    return sentences


def check_application(scope: Scope, task: str, application: str) -> None:
    """Check that a task (`<namespace>/<name>`) may ask for this application; RefusalError(OutsideScope)."""
    if not scope.covers_application(application):
        may = _listed(scope.applications)
        raise RefusalError(
            OUTSIDE_SCOPE,
            f"task {task} may not ask for application {application!r}: its operator may launch {may}; ask for one of "
            "them, or add it to scope.applications (charts/robotkube, values managers)",
        )


def check_releases(scope: Scope, task: str, namespaces: Iterable[str]) -> None:
    """Check that a task leads only to releases on agents (by namespace) that it may touch;
    RefusalError(OutsideScope)."""
    outside = sorted(name for name in set(namespaces) if not scope.covers_agent(name))
    if outside:
        raise RefusalError(
            OUTSIDE_SCOPE,
            f"task {task} leads to releases on {', '.join(outside)}: its operator may touch {_listed(scope.agents)}; "
            "ask for less, or add the agent to scope.agents (charts/robotkube, values managers)",
        )


def _listed(names: Collection[str]) -> str:
    return ", ".join(sorted(names)) or "nothing"


@dataclass(frozen=True)
class ScopedFleet(Fleet):
    """The part of a fleet that a scope holds; `outside` are declared agents of other scopes, by name, `borders` those
    with their scopes."""

    outside: Mapping[str, Agent] = field(default_factory=dict)
    borders: Borders = field(default_factory=Borders)

    def agent(self, name: object) -> Agent:
        """A declared agent that has a node, as Fleet.agent; RefusalError(OutsideScope) for one of another scope."""
        if isinstance(name, str) and name in self.outside:
            own = _listed(self.agents)
            raise RefusalError(
                OUTSIDE_SCOPE,
                f"agent {name!r} belongs to another scope; this one holds {own}. Ask the manager of that agent, or "
                "move the agent in scope.agents (charts/robotkube, values managers)",
            )
        return super().agent(name)

    def link_end(self, name: object) -> Agent:
        """As Fleet.link_end: also an agent of another scope, whether or not it has a node. Where it is not known whose
        it is, RefusalError(OutsideScope)."""
        known = isinstance(name, str) and name in self.outside and name in self.borders.scopes
        return self.outside[str(name)] if known else self.agent(name)

    @property
    def has_borders(self) -> bool:
        """As Fleet.has_borders."""
        return bool(self.borders.scopes)

    def check_heard(self, topic: str, listener: str) -> None:
        """As Fleet.check_heard; RefusalError(LinkNotConsented) says which consent main lacks."""
        if obstacle := self.borders.obstacle(topic, listener):
            raise RefusalError(LINK_NOT_CONSENTED, obstacle)


def scoped_fleet(whole: Fleet, scope: Scope, borders: Borders | None = None) -> Fleet:
    """The agents of `scope` with their nodes; `whole` itself when it holds all of them."""
    outside = {name: agent for name, agent in whole.agents.items() if not scope.covers_agent(name)}
    if not outside:
        return whole
    agents = {name: agent for name, agent in whole.agents.items() if name not in outside}
    nodes = {name: machines for name, machines in whole.nodes.items() if name not in outside}
    return ScopedFleet(agents, nodes, outside=outside, borders=borders or Borders())


def own_releases(releases: Mapping[str, Release], agents: Iterable[Agent], scope: Scope) -> dict[str, Release]:
    """The releases (by path) that a manager of `scope` answers for: all but those on agents of other scopes. A release
    where no declared agent is belongs to the manager of everything, so that it goes when its agent is no longer
    declared."""
    own = _Own(agents, scope)
    return {path: release for path, release in releases.items() if release.namespace in own}


def own_sources(sources: Mapping[str, Source], agents: Iterable[Agent], scope: Scope) -> dict[str, Source]:
    """The sources (by path) beside those releases."""
    own = _Own(agents, scope)
    return {path: source for path, source in sources.items() if source.namespace in own}


class _Own:
    """The namespaces whose files belong to a scope."""

    def __init__(self, agents: Iterable[Agent], scope: Scope) -> None:
        self._owned = {agent.namespace: scope.covers_agent(agent.name) for agent in agents}
        self._rest = not scope.is_narrow

    def __contains__(self, namespace: str) -> bool:
        return self._owned.get(namespace, self._rest)


def unknown_nodes(nodes: Iterable[NodeState], declared: Collection[str]) -> tuple[NodeState, ...]:
    """Nodes whose agent is not among the `declared` names, by name: nothing is placed on them. Machines of role
    PLATFORM carry the platform itself and are no agents."""
    unknown = (node for node in nodes if node.agent not in declared and node.role != PLATFORM)
    return tuple(sorted(unknown, key=lambda node: node.name))
