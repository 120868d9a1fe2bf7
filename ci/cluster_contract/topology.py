"""The `topology` section of a scenario.yaml, read and checked into a tuple of nodes.

Every refusal names file, key and fix. Nothing is defaulted silently but `count` (1) and `capabilities` (none). A
capability `lidar` is every node's of its entry, `{lidar: 2}` that of the first two.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ci import yaml_files
from ci.errors import InputError
from robotkube.foundation.documents.core.quantities import CPU, MEMORY, quantity_of_form

NODES_MAX = 100
LABEL = re.compile(r"[a-z0-9]([-a-z0-9]{0,38}[a-z0-9])?")
MEMORY_MINIMUM_BYTES = 256 * 2**20
PLAYERS = ("vehicle", "roadside")  # roles whose agents play a bag
BAGS_SIZE = "2Gi"
NODE_KEYS = {"name", "count", "role", "agent", "capacity", "capabilities"}

# In the world each of them is a machine of its own. Where all share one, vehicles go on as they would there, all wait
# for the cloud, and the platform gets what is left, but for the broker: all vehicles wait for that.
WEIGHTS = {"platform": 200, "cloud": 800}
WEIGHT = 300


def agent_labels(role: str, agent: str, capabilities: Iterable[str]) -> dict[str, str]:
    """The labels of an agent's Node."""
    named = {"robotkube.io/role": role, "robotkube.io/agent": agent}
    return named | {f"robotkube.io/capability.{capability}": "true" for capability in capabilities}


class AgentOfNode(Protocol):
    """Whose a Node is."""

    @property
    def role(self) -> str: ...
    @property
    def agent(self) -> str: ...
    @property
    def capabilities(self) -> tuple[str, ...]: ...


def chart_agents(nodes: Iterable[AgentOfNode]) -> list[dict[str, Any]]:
    """Values `agents` of charts/robotkube: those of all Nodes outside of the platform."""
    agents: dict[str, dict[str, Any]] = {}
    for node in nodes:
        if node.role == "platform":
            continue
        agent = agents.setdefault(node.agent, {"name": node.agent, "role": node.role})
        if "recording" in node.capabilities:
            agent["records"] = True
        if node.role in PLAYERS:
            agent["claims"] = [{"name": "bags", "size": BAGS_SIZE}]
    return list(agents.values())


@dataclass(frozen=True)
class NodeSpec:
    """One node: what is offered to pods (`cpu_millicores`, `memory_bytes`) and how it is labelled."""

    name: str
    role: str
    agent: str
    cpu_millicores: int
    memory_bytes: int
    capabilities: tuple[str, ...]

    @property
    def weight(self) -> int:
        """Of its pods, when nodes want more processor time than there is."""
        return WEIGHTS.get(self.role, WEIGHT)

    @property
    def labels(self) -> dict[str, str]:
        """Node labels that placement reads (docs/reference/contracts.md)."""
        return agent_labels(self.role, self.agent, self.capabilities)

    @property
    def taints(self) -> tuple[dict[str, str], ...]:
        """Platform nodes are for the platform's own pods."""
        if self.role != "platform":
            return ()
        return ({"key": "robotkube.io/role", "value": "platform", "effect": "NoSchedule"},)


@dataclass(frozen=True)
class Topology:
    """The nodes of one cluster, in the order of the file; a node's place is its number in the address plan."""

    nodes: tuple[NodeSpec, ...]


def read(path: Path, overrides: Mapping[str, str] | None = None) -> Topology:
    """Read `path`; `overrides` replace counts: `vehicles=3` is the count of the entry of role `vehicle`."""
    document = yaml_files.read(path, "give a scenario.yaml with --topology")
    if not isinstance(document, dict) or "topology" not in document:
        raise InputError(f"{path}: topology: is missing; add `topology: {{nodes: [...]}}`")
    return _Reader(str(path)).topology(document["topology"], dict(overrides or {}))


def overrides(settings: Iterable[str]) -> dict[str, str]:
    """`vehicles=3` -> {"vehicles": "3"}; InputError where something is no such pair."""
    pairs = [setting.partition("=") for setting in settings]
    for name, equals, _ in pairs:
        if not equals:
            raise InputError(f"--set {name}: must be PARAMETER=VALUE, for example vehicles=3")
    return {name: value for name, _, value in pairs}


class _Reader:
    """Checks one document; `where` is the key path for messages."""

    def __init__(self, file: str) -> None:
        self.file = file

    def refuse(self, key: str, problem: str) -> InputError:
        return InputError(f"{self.file}: {key}: {problem}")

    def topology(self, section: Any, overrides: dict[str, str]) -> Topology:
        entries = section.get("nodes") if isinstance(section, dict) else None
        if not isinstance(entries, list) or not entries:
            raise self.refuse("topology.nodes", "must be a list with at least one node")
        self._known("topology", section, {"nodes"})
        self._counts(entries, overrides)
        nodes = tuple(node for number, entry in enumerate(entries) for node in self._entry(number, entry))
        self._together(nodes)
        return Topology(nodes)

    def _counts(self, entries: list[Any], overrides: dict[str, str]) -> None:
        for name, value in overrides.items():
            targets = [e for e in entries if isinstance(e, dict) and "count" in e and f"{e.get('role')}s" == name]
            if not targets:
                raise InputError(f"--set {name}: no node entry of role {name.removesuffix('s')!r} has a count")
            if not value.isdecimal():
                raise InputError(f"--set {name}={value}: must be a whole number")
            for target in targets:
                target["count"] = int(value)

    def _entry(self, number: int, entry: Any) -> Iterable[NodeSpec]:
        key = f"topology.nodes[{number}]"
        if not isinstance(entry, dict):
            raise self.refuse(key, "must be a mapping with name, role, agent and capacity")
        self._known(key, entry, NODE_KEYS)
        count = entry.get("count", 1)
        if not isinstance(count, int) or isinstance(count, bool) or not 0 <= count <= NODES_MAX:
            raise self.refuse(f"{key}.count", f"{count!r} must be a whole number from 0 to {NODES_MAX}")
        if count > 1 and "{index" not in str(entry.get("name")):
            raise self.refuse(f"{key}.name", "must contain {index:02} because count is more than 1")
        for index in range(count):
            yield self._node(key, entry, index)

    def _node(self, key: str, entry: dict[str, Any], index: int) -> NodeSpec:
        capabilities = entry.get("capabilities", [])
        if not isinstance(capabilities, list):
            raise self.refuse(f"{key}.capabilities", "must be a list, for example [recording]")
        capacity = entry.get("capacity")
        if not isinstance(capacity, dict):
            raise self.refuse(f"{key}.capacity", 'is missing; add {cpu: "1", memory: 2Gi}')
        self._known(f"{key}.capacity", capacity, {"cpu", "memory"})
        return NodeSpec(
            name=self._label(f"{key}.name", entry.get("name"), index),
            role=self._label(f"{key}.role", entry.get("role"), index),
            agent=self._label(f"{key}.agent", entry.get("agent"), index),
            cpu_millicores=self._cpu(f"{key}.capacity.cpu", capacity.get("cpu")),
            memory_bytes=self._memory(f"{key}.capacity.memory", capacity.get("memory")),
            capabilities=tuple(self._capabilities(f"{key}.capabilities", capabilities, index)),
        )

    def _capabilities(self, key: str, entries: list[Any], index: int) -> Iterable[str]:
        for entry in entries:
            first = entry if isinstance(entry, dict) else {entry: NODES_MAX}
            for name, count in first.items():
                if not isinstance(count, int) or isinstance(count, bool) or not 0 <= count <= NODES_MAX:
                    raise self.refuse(f"{key}.{name}", f"{count!r} must be how many of the first nodes have it")
                if index < count:
                    yield self._label(key, name, index)

    def _label(self, key: str, value: Any, index: int) -> str:
        if not isinstance(value, str) or not value:
            raise self.refuse(key, "is missing or no text")
        try:
            text = value.format(index=index)
        except (KeyError, IndexError, ValueError) as error:
            raise self.refuse(key, f"{value!r} may contain only {{index}}, for example {{index:02}}") from error
        if not LABEL.fullmatch(text):
            raise self.refuse(key, f"{text!r} must be lower-case letters, digits and hyphens, at most 40")
        return text

    def _cpu(self, key: str, value: Any) -> int:
        millicores = int((quantity_of_form(value, CPU) or 0) * 1000)
        if millicores < 100:
            raise self.refuse(key, f'{value!r} must be cores ("1", "0.5") or millicores ("500m"), at least 100m')
        return millicores

    def _memory(self, key: str, value: Any) -> int:
        size = int(quantity_of_form(value, MEMORY) or 0)
        if size < MEMORY_MINIMUM_BYTES:
            raise self.refuse(key, f"{value!r} must be a size such as 2Gi or 512Mi, at least 256Mi")
        return size

    def _known(self, key: str, mapping: dict[str, Any], known: set[str]) -> None:
        unknown = sorted(set(map(str, mapping)) - known)
        if unknown:
            raise self.refuse(f"{key}.{unknown[0]}", f"is unknown; known keys are {', '.join(sorted(known))}")

    def _together(self, nodes: tuple[NodeSpec, ...]) -> None:
        names = [node.name for node in nodes]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise self.refuse("topology.nodes", f"the name {twice[0]!r} occurs twice; names must differ")
        if not 0 < len(nodes) <= NODES_MAX:
            raise self.refuse("topology.nodes", f"{len(nodes)} nodes; there must be 1 to {NODES_MAX}")
