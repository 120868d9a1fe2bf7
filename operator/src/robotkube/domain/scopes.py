"""What a manager, and an operator within it, may touch: namespaces whose tasks it answers, agents, applications.

A manager plans for its own agents only, and leaves every release of other agents as it is on main. An agent belongs to
exactly one manager, so every bridge has one author, and no topic two publishers on a node. An operator is the author of
the tasks in one namespace; its scope is never more than its manager's, and in a chain never more than its parent's.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from robotkube.domain.errors import RefusalError
from robotkube.domain.placement import Agent, Fleet, NodeState
from robotkube.domain.releases import Release, Source

ALL = "*"
OUTSIDE_SCOPE = "OutsideScope"
PLATFORM = "platform"
EVERYTHING = frozenset({ALL})


@dataclass(frozen=True)
class Scope:
    """Names, or `*` for all: `namespaces` of tasks, `agents` whose releases may change, `applications`."""

    namespaces: frozenset[str] = EVERYTHING
    agents: frozenset[str] = EVERYTHING
    applications: frozenset[str] = EVERYTHING

    def covers_namespace(self, name: str) -> bool:
        """Whether tasks of this namespace belong to it."""
        return _covers(self.namespaces, name)

    def covers_agent(self, name: str) -> bool:
        """Whether releases on this agent belong to it."""
        return _covers(self.agents, name)

    def covers_application(self, name: str) -> bool:
        """Whether its tasks may ask for this application."""
        return _covers(self.applications, name)

    def subset(self, other: Scope) -> bool:
        """Whether nothing is in it that is not in `other`."""
        pairs = zip(self._parts(), other._parts(), strict=True)
        return all(ALL in theirs or (ALL not in mine and mine <= theirs) for mine, theirs in pairs)

    def narrowed(self, other: Scope) -> Scope:
        """What is in both: a subset of each."""
        return Scope(*(_both(mine, theirs) for mine, theirs in zip(self._parts(), other._parts(), strict=True)))

    @property
    def named_namespaces(self) -> frozenset[str]:
        """The namespaces by name; none for all."""
        return frozenset() if ALL in self.namespaces else self.namespaces

    @property
    def is_narrow(self) -> bool:
        """Whether there are agents outside of it."""
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
class Operators:
    """The scope of a manager, and the scopes declared for operators: namespace of their tasks -> agents and
    applications (`namespaces` of these is not looked at)."""

    manager: Scope = field(default_factory=Scope)
    declared: Mapping[str, Scope] = field(default_factory=dict)

    @property
    def unbounded(self) -> bool:
        """Whether every task may ask for everything."""
        return not self.declared and ANYTHING.subset(self.manager)

    def scope(self, namespaces: Sequence[str]) -> Scope:
        """What a task may ask for whose chain comes through these namespaces, its own included: never more than any
        operator of the chain may."""
        found = self.manager
        for namespace in namespaces:
            declared = self.declared.get(namespace)
            if declared is not None:
                found = found.narrowed(Scope(EVERYTHING, declared.agents, declared.applications))
        return found


def check_application(scope: Scope, task: str, application: str) -> None:
    """RefusalError(OutsideScope) when a task (`<namespace>/<name>`) may not ask for this application."""
    if not scope.covers_application(application):
        may = _listed(scope.applications)
        raise RefusalError(
            OUTSIDE_SCOPE,
            f"task {task} may not ask for application {application!r}: its operator may launch {may}; ask for one of "
            "them, or add it to scope.applications (charts/robotkube, values managers)",
        )


def check_releases(scope: Scope, task: str, namespaces: Iterable[str]) -> None:
    """RefusalError(OutsideScope) when a task leads to releases on agents (by namespace) that it may not touch."""
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
    """The part of a fleet that a scope holds; `outside` are declared agents of other scopes."""

    outside: frozenset[str] = frozenset()

    def agent(self, name: object) -> Agent:
        """As Fleet.agent; RefusalError(OutsideScope) for a declared agent of another scope."""
        if isinstance(name, str) and name in self.outside:
            own = _listed(self.agents)
            raise RefusalError(
                OUTSIDE_SCOPE,
                f"agent {name!r} belongs to another scope; this one holds {own}. Ask the manager of that agent, or "
                "move the agent in scope.agents (charts/robotkube, values managers)",
            )
        return super().agent(name)


def scoped_fleet(whole: Fleet, scope: Scope) -> Fleet:
    """The agents of `scope` with their nodes; `whole` itself when it holds all of them."""
    outside = frozenset(name for name in whole.agents if not scope.covers_agent(name))
    if not outside:
        return whole
    agents = {name: agent for name, agent in whole.agents.items() if name not in outside}
    nodes = {name: found for name, found in whole.nodes.items() if name not in outside}
    return ScopedFleet(agents, nodes, outside=outside)


def own_releases(releases: Mapping[str, Release], agents: Iterable[Agent], scope: Scope) -> dict[str, Release]:
    """The releases (by path) that a manager of `scope` answers for: all but those on agents of other scopes. A release
    where no declared agent is belongs to the manager of everything, so that it goes when its agent is no longer
    declared."""
    own = _Own(agents, scope)
    return {path: found for path, found in releases.items() if found.namespace in own}


def own_sources(sources: Mapping[str, Source], agents: Iterable[Agent], scope: Scope) -> dict[str, Source]:
    """The sources (by path) beside those releases."""
    own = _Own(agents, scope)
    return {path: found for path, found in sources.items() if found.namespace in own}


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
    found = (node for node in nodes if node.agent not in declared and node.role != PLATFORM)
    return tuple(sorted(found, key=lambda node: node.name))
