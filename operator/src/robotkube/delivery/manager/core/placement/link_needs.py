"""Needs of links: what the agent of a service must be allowed at the broker for its links to carry."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from robotkube.robots.bridge.core.rights import OUT, Account, may, may_anybody


@dataclass(frozen=True)
class LinkNeed:
    """What one link asks of an agent: to send (`out`) or to receive (`in`) a topic; the latter any agent may be given.
    Not of the `agent` at the link's other end, where ROS carries the topic, nor of agents of its `role`, which depend
    on who else has that role."""

    direction: str
    topic: str
    agent: str = ""
    role: str = ""

    @property
    def binds(self) -> bool:
        """Return whether there can be an agent that cannot have it."""
        return not may_anybody(self.direction, self.topic)

    def obstacle(self, agent: Account) -> str:
        """Why an agent cannot have it; empty when it can."""
        exempt = agent.name == self.agent or (self.role and agent.role == self.role)
        if exempt or may(agent, self.direction, self.topic):
            return ""
        return f"may not {'write' if self.direction == OUT else 'read'} {self.topic} at the broker"


def forbidden(needs: Sequence[LinkNeed], agents: Iterable[Account]) -> Mapping[str, str]:
    """Those of the agents that cannot have a need, by name, with why. Nobody when none can have them: then the link is
    refused, and not the place."""
    against = {agent.name: next(filter(None, (need.obstacle(agent) for need in needs)), "") for agent in agents}
    return {name: why for name, why in against.items() if why} if "" in against.values() else {}
