"""The file agents.yaml: which of a cluster's Nodes are whose.

    agents:
    - {node: worker-1, role: platform, agent: platform}
    - {node: worker-2, role: cloud, agent: cloud-0, capabilities: [recording]}
    - {selector: {example.com/robot: "7"}, role: vehicle, agent: vehicle-00, capabilities: [lidar, recording]}

An entry means the Node of that name, or every Node with these labels. With `trial: true` beside `agents`, several
entries may mean one Node, which is then several agents' (decision 0082). Every refusal names file, key and fix.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ci import yaml_files
from ci.cluster_contract.topology import LABEL, NodeSpec, Topology, agent_labels
from ci.errors import InputError
from robotkube.delivery.deployment.core.policies.agents import ROLES

PLATFORM = "platform"  # a role whose agent may have any name
NAME = re.compile(r"[a-z]([-a-z0-9]*[a-z0-9])?")  # a namespace and a ROS name, as the platform's chart takes it
NAME_CHARACTERS_MAX = 22
FILE_KEYS = {"agents", "trial"}
KEYS = {"node", "selector", "role", "agent", "capabilities"}
EXAMPLE = "agents: [{node: worker-1, role: vehicle, agent: vehicle-00, capabilities: [lidar]}]"


@dataclass(frozen=True)
class AgentEntry:
    """One entry: the Node called `node`, or those with the labels `selector`, and what they are to be."""

    node: str
    selector: tuple[tuple[str, str], ...]
    role: str
    agent: str
    capabilities: tuple[str, ...] = ()

    def means(self, name: str, labels: Mapping[str, str]) -> bool:
        """Return whether a Node is meant."""
        return name == self.node if self.node else all(labels.get(key) == value for key, value in self.selector)

    @property
    def labels(self) -> dict[str, str]:
        """What makes a Node this agent's."""
        return agent_labels(self.role, self.agent, self.capabilities)

    def __str__(self) -> str:
        nodes = f"node {self.node}" if self.node else ",".join(f"{key}={value}" for key, value in self.selector)
        return f"{self.agent} ({nodes})"


@dataclass(frozen=True)
class AgentsFile:
    """What the file `name` says: `trial`: one Node may be several agents'."""

    entries: tuple[AgentEntry, ...]
    trial: bool = False
    name: str = field(default="agents.yaml", compare=False)


def read(path: Path) -> AgentsFile:
    """What a file says; InputError."""
    document = yaml_files.read(path, f"write one, for example: {EXAMPLE}")
    entries = document.get("agents") if isinstance(document, dict) else None
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path}: agents: must be a list with at least one entry, for example: {EXAMPLE}")
    unknown = sorted(set(map(str, document)) - FILE_KEYS)
    if unknown:
        raise InputError(f"{path}: {unknown[0]}: is unknown; known keys are {', '.join(sorted(FILE_KEYS))}")
    trial = document.get("trial", False)
    if not isinstance(trial, bool):
        raise InputError(f"{path}: trial: {trial!r} must be true (several agents may share a Node) or false")
    read_entries = tuple(_entry(f"{path}: agents[{number}]", entry) for number, entry in enumerate(entries))
    return AgentsFile(read_entries, trial, str(path))


def require_agents(file: AgentsFile, topology: Topology) -> None:
    """InputError names the agents of a scenario that have no entry of their role with what they are capable of."""
    lacking = {node.agent: node for node in topology.nodes if not any(_is(entry, node) for entry in file.entries)}
    if lacking:
        wanted = (f"{one.agent} (role {one.role}{_capable(one)})" for one in lacking.values())
        raise InputError(
            f"{file.name}: the scenario needs Nodes of {', '.join(wanted)}; add them, or take fewer: --set"
        )


def _is(entry: AgentEntry, node: NodeSpec) -> bool:
    same_agent = entry.agent == node.agent or node.role == PLATFORM
    return same_agent and entry.role == node.role and set(node.capabilities) <= set(entry.capabilities)


def _capable(node: NodeSpec) -> str:
    return f", capabilities [{', '.join(node.capabilities)}]" if node.capabilities else ""


def read_values(path: Path) -> dict[str, Any]:
    """Values of the platform's chart in a file; InputError."""
    document = yaml_files.read(path, "name a file with VALUES")
    if not isinstance(document, dict):
        raise InputError(f"{path}: must be a mapping, as a file of values for charts/robotkube is")
    return document


def _entry(where: str, entry: Any) -> AgentEntry:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: must be a mapping, for example: {EXAMPLE}")
    unknown = sorted(set(map(str, entry)) - KEYS)
    if unknown:
        raise InputError(f"{where}.{unknown[0]}: is unknown; known keys are {', '.join(sorted(KEYS))}")
    if ("node" in entry) == ("selector" in entry):
        raise InputError(f"{where}: must have either node (the name of one) or selector (labels of several)")
    node = entry.get("node", "")
    if "node" in entry and (not isinstance(node, str) or not node):
        raise InputError(f"{where}.node: {node!r} must be the name of a Node")
    role, agent = (_label(f"{where}.{key}", entry.get(key)) for key in ("role", "agent"))
    _require_known(where, role, agent)
    return AgentEntry(node, tuple(_selector(where, entry)), role, agent, tuple(_capabilities(where, entry)))


def _require_known(where: str, role: str, agent: str) -> None:
    """InputError for what the platform's chart would refuse, when the Nodes have their labels already."""
    if role != PLATFORM and role not in ROLES:
        raise InputError(f"{where}.role: {role!r} must be one of {', '.join((PLATFORM, *ROLES))}")
    if role != PLATFORM and (not NAME.fullmatch(agent) or len(agent) > NAME_CHARACTERS_MAX):
        raise InputError(
            f"{where}.agent: {agent!r} becomes a namespace and a ROS name: it must begin with a letter and have at "
            f"most {NAME_CHARACTERS_MAX} characters, such as vehicle-00"
        )


def _selector(where: str, entry: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    selector = entry.get("selector", {})
    if "selector" in entry and (not isinstance(selector, dict) or not selector):
        raise InputError(f'{where}.selector: must be labels of Nodes, for example {{example.com/robot: "7"}}')
    for key, value in sorted(selector.items()):
        if not isinstance(value, str):
            raise InputError(f'{where}.selector.{key}: {value!r} must be text; write it in quotes: "{value}"')
        yield str(key), value


def _capabilities(where: str, entry: Mapping[str, Any]) -> Iterator[str]:
    capabilities = entry.get("capabilities", [])
    if not isinstance(capabilities, list):
        raise InputError(f"{where}.capabilities: must be a list, for example [recording]")
    for capability in capabilities:
        yield _label(f"{where}.capabilities", capability)


def _label(where: str, value: Any) -> str:
    if not isinstance(value, str) or not LABEL.fullmatch(value):
        raise InputError(f"{where}: {value!r} must be lower-case letters, digits and hyphens, at most 40")
    return value
