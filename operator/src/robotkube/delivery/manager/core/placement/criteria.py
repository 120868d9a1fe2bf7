"""What an agent has to be for a group of services."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AgentCriteria:
    """Conditions, apart from time and neighbours, on which an agent can carry a group; empty is no condition.
    `named`: the agent that it is bound to; `unfit_for_guests`: chart versions that guests of a Node cannot run."""

    role: str
    roles: tuple[str, ...]
    agents: tuple[str, ...]
    capabilities: tuple[str, ...]
    platforms: tuple[tuple[str, ...], ...]
    named: str = ""
    unfit_for_guests: tuple[str, ...] = ()

    def __str__(self) -> str:
        words = [f"role {self.role}"] if self.role else []
        words += [f"one of the roles {', '.join(self.roles)}"] if self.roles else []
        words += [f"one of the agents {', '.join(self.agents)}"] if self.agents else []
        words += [f"capability {c}" for c in self.capabilities]
        return ", ".join(words or ["any role"])
