"""The fleet as a view shows it: agents with their Nodes, pods and releases, as the API server has them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.manager.adapters.pod_states import read_pod, read_time_ns
from robotkube.foundation.kubernetes.core.node_agents import NodeAgent, node_agents, trial_words
from robotkube.foundation.kubernetes.core.objects import object_key

PLATFORM_ROLE = "platform"


@dataclass(frozen=True)
class PodLook:
    """One look at a pod of an agent's release."""

    key: str
    release: str
    running: bool
    ready: bool
    restarts: int
    ended: str


@dataclass(frozen=True)
class NodeLook:
    """One look at a Node and its `agents`: `since` when it is as it is (ns since 1970); `silent`: its kubelet says
    nothing."""

    name: str
    agents: tuple[NodeAgent, ...]
    ready: bool
    silent: bool
    since: int | None


@dataclass(frozen=True)
class AgentRow:
    """An agent in one line: how many of its pods are ready, and what runs. `since`: when its machine became as it is,
    where it is not `ready`; `silent`: nothing is heard of it."""

    agent: str
    role: str
    silent: bool
    ready: bool
    since: int | None
    pods_ready: int
    pods: int
    runs: tuple[str, ...]

    @property
    def is_fine(self) -> bool:
        """Return whether nobody needs to look at it."""
        return self.ready and self.pods_ready == self.pods


def look_at_pod(item: Mapping[str, Any]) -> PodLook:
    """A pod of the API server."""
    state = read_pod(item)
    ended = [container.ended_why for container in state.containers if container.ended_why]
    return PodLook(
        object_key(item),
        state.release.partition("/")[2],
        item.get("status", {}).get("phase") == "Running",
        bool(state.containers) and all(container.ready for container in state.containers),
        sum(container.restarts for container in state.containers),
        ended[0] if ended else "",
    )


def look_at_node(item: Mapping[str, Any]) -> NodeLook:
    """A Node of the API server."""
    labels = item["metadata"].get("labels", {})
    conditions = [one for one in item.get("status", {}).get("conditions", []) if one.get("type") == "Ready"]
    ready = conditions[0] if conditions else {}
    return NodeLook(
        item["metadata"]["name"],
        node_agents(labels),
        ready.get("status") == "True",
        ready.get("status", "Unknown") == "Unknown",
        read_time_ns(ready.get("lastTransitionTime")),
    )


def rows(nodes: Iterable[NodeLook], pods: Iterable[PodLook]) -> list[AgentRow]:
    """The agents, those that somebody should look at first, then by name; what carries the platform is no agent."""
    by_agent: dict[str, list[NodeLook]] = {}
    roles: dict[str, str] = {}
    for node in nodes:
        for agent in node.agents:
            if agent.role != PLATFORM_ROLE:
                roles.setdefault(agent.name, agent.role)
                by_agent.setdefault(agent.name, []).append(node)
    by_namespace: dict[str, list[PodLook]] = {}
    for pod in pods:
        by_namespace.setdefault(pod.key.partition("/")[0], []).append(pod)
    agents = [_row(agent, roles[agent], own, by_namespace.get(agent, [])) for agent, own in by_agent.items()]
    return sorted(agents, key=lambda row: (row.is_fine, row.agent))


def _row(agent: str, role: str, nodes: list[NodeLook], pods: list[PodLook]) -> AgentRow:
    away = [node for node in nodes if not node.ready]
    return AgentRow(
        agent,
        role,
        any(node.silent for node in away),
        not away,
        min((node.since for node in away if node.since), default=None),
        sum(pod.ready for pod in pods),
        len(pods),
        tuple(sorted({pod.release for pod in pods if pod.release})),
    )


def trial(nodes: Iterable[NodeLook]) -> str:
    """What has to be said where Nodes are several agents'; empty where none is."""
    named = {node.name: [agent.name for agent in node.agents] for node in nodes if len(node.agents) > 1}
    return trial_words(dict(sorted(named.items())))
