"""Which agent a service runs on, with the reason for every candidate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robotkube.domain.catalogue_applications import PlacementRule
from robotkube.domain.errors import RefusalError


@dataclass(frozen=True, order=True)
class Agent:
    """A declared machine of the fleet; its node may not exist yet."""

    name: str
    role: str
    namespace: str


@dataclass(frozen=True)
class NodeState:
    """A Node that belongs to an agent (label robotkube.io/agent)."""

    name: str
    agent: str
    role: str
    capabilities: frozenset[str]
    ready: bool
    cordoned: bool = False


@dataclass(frozen=True)
class Placement:
    """The agent chosen, and one sentence per candidate."""

    agent: Agent
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Fleet:
    """Declared agents and their nodes."""

    agents: Mapping[str, Agent]
    nodes: Mapping[str, tuple[NodeState, ...]]

    def present(self, role: str) -> tuple[Agent, ...]:
        """Declared agents of a role that have a node, by name."""
        return tuple(a for name, a in sorted(self.agents.items()) if a.role == role and self.nodes.get(name))

    def agent(self, name: object) -> Agent:
        """A declared agent that has a node; RefusalError(NoCapableNode) says which of both it lacks."""
        if not isinstance(name, str) or name not in self.agents:
            raise RefusalError("NoCapableNode", f"agent {name!r} is not declared in the platform's values")
        if not self.nodes.get(name):
            raise RefusalError("NoCapableNode", f"agent {name!r} has no Node with label robotkube.io/agent={name}")
        return self.agents[name]


def fleet(agents: Sequence[Agent], nodes: Sequence[NodeState]) -> Fleet:
    """Agents and nodes by agent name."""
    by_agent: dict[str, list[NodeState]] = {}
    for node in sorted(nodes, key=lambda n: n.name):
        by_agent.setdefault(node.agent, []).append(node)
    return Fleet({a.name: a for a in agents}, {name: tuple(found) for name, found in by_agent.items()})


def place(rule: PlacementRule, fleet: Fleet, kept: frozenset[str], load: Mapping[str, int]) -> Placement:
    """The agent for a service.

    `rule.agent` (already rendered) names it; else the agents of `rule.role` are candidates. `kept` are agents that run
    the release already: one of them stays, even when it is not ready at the moment. Else the one with the least `load`
    (releases placed so far), then the first by name. RefusalError(NoCapableNode) gives every candidate's reason.
    """
    if rule.agent:
        agent = fleet.agent(rule.agent)
        return Placement(agent, (f"{agent.name}: named by the application",))
    candidates = [agent for _, agent in sorted(fleet.agents.items()) if agent.role == rule.role]
    obstacles = {
        agent.name: _obstacle(rule, fleet.nodes.get(agent.name, ()), agent.name in kept) for agent in candidates
    }
    free = [agent for agent in candidates if not obstacles[agent.name]]
    if not free:
        detail = "; ".join(f"{name}: {text}" for name, text in obstacles.items()) or "no agent of that role is declared"
        wanted = " ".join([f"role {rule.role}", *(f"capability {c}" for c in rule.capabilities)])
        raise RefusalError("NoCapableNode", f"no agent for {wanted}: {detail}")
    chosen = min(free, key=lambda a: (a.name not in kept, load.get(a.name, 0), a.name))
    return Placement(chosen, tuple(_reason(a.name, obstacles[a.name], chosen.name, kept, load) for a in candidates))


def _obstacle(rule: PlacementRule, nodes: Sequence[NodeState], kept: bool) -> str:
    if not nodes:
        return "has no Node"
    missing = [c for c in rule.capabilities if not any(c in node.capabilities for node in nodes)]
    if missing:
        return f"lacks capability {', '.join(missing)}"
    if kept or any(node.ready and not node.cordoned for node in nodes):
        return ""
    return "no Node is Ready and schedulable"


def _reason(name: str, obstacle: str, chosen: str, kept: frozenset[str], load: Mapping[str, int]) -> str:
    if obstacle:
        return f"{name}: {obstacle}"
    if name == chosen:
        return f"{name}: taken, {'it runs there already' if name in kept else f'{load.get(name, 0)} releases placed'}"
    return f"{name}: possible, {load.get(name, 0)} releases placed"
