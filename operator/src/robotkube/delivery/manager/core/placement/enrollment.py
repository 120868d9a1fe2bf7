"""Enrollment: which of the declared agents are there, as main says."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from robotkube.delivery.manager.core.placement.placement import Agent


def enrolled_agents(declared: Iterable[Agent], enrolled: Mapping[str, str]) -> tuple[Agent, ...]:
    """The agents that are there: those with a role of their own, and of the reserved ones those that main enrolls
    (agent -> role), with that role."""
    roles = ((agent, agent.role or enrolled.get(agent.name, "")) for agent in declared)
    return tuple(agent if agent.role else replace(agent, role=role) for agent, role in roles if role)
