"""Which labels are added to given Nodes, and which are taken away again. Pure.

What was added stands on each Node, in an annotation: so it can be taken away from any machine, and nothing else is.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from ci.cluster.existing.mapping import AgentEntry, AgentsFile
from ci.cluster_contract import sharing
from ci.errors import InputError

ADDED = "robotkube.io/added-labels"  # annotation: the labels that were added, as a JSON object
Values = Mapping[str, str | None]


@dataclass(frozen=True)
class GivenNode:
    """A Node of a cluster as it is."""

    name: str
    labels: Mapping[str, str]
    annotations: Mapping[str, str] = field(default_factory=dict)

    @property
    def added(self) -> dict[str, str]:
        """The labels that were added to it; InputError where the annotation cannot be read."""
        text = self.annotations.get(ADDED, "{}")
        try:
            added = json.loads(text)
        except ValueError:
            added = None
        if not isinstance(added, dict) or not all(isinstance(value, str) for value in added.values()):
            raise InputError(
                f"Node {self.name}: annotation {ADDED}: {text!r} is no object of labels; write there which labels were "
                "added, or take it away"
            )
        return added


@dataclass(frozen=True)
class NodeChange:
    """What is to be written to a Node: values of labels and annotations, None for those that go. `notes` say what is
    left as it is though it was added once."""

    node: str
    labels: Values
    annotations: Values
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        words = [f"label {key} {f'= {value}' if value is not None else 'goes'}" for key, value in self.labels.items()]
        return f"Node {self.node}: {', '.join([*words, *self.notes]) or 'the list of added labels alone'}"


def adding(nodes: Sequence[GivenNode], file: AgentsFile) -> tuple[NodeChange, ...]:
    """What makes the Nodes those of the file's entries, and of no others; Nodes that are so already need nothing.
    InputError names what stands in the way."""
    wanted = wanted_labels(nodes, file)
    changes = (_added(node, wanted.get(node.name, {})) for node in nodes)
    return tuple(change for change in changes if change is not None)


def wanted_labels(nodes: Sequence[GivenNode], file: AgentsFile) -> dict[str, Mapping[str, str]]:
    """The labels by which Nodes (by name) are those of the file's entries; InputError names what stands in the way."""
    return {name: sharing.labels(entries) for name, entries in _owners(nodes, file).items()}


def removing(nodes: Sequence[GivenNode]) -> tuple[NodeChange, ...]:
    """What takes away all that was added."""
    changes = (_added(node, {}) for node in nodes)
    return tuple(change for change in changes if change is not None)


def _owners(nodes: Sequence[GivenNode], file: AgentsFile) -> dict[str, list[AgentEntry]]:
    owners: dict[str, list[AgentEntry]] = {}
    for entry in file.entries:
        meant = [node.name for node in nodes if entry.means(node.name, node.labels)]
        if not meant:
            there = ", ".join(node.name for node in nodes) or "none"
            raise InputError(f"{file.name}: {entry}: there is no such Node; there is: {there}")
        for name in meant:
            others = owners.setdefault(name, [])
            if others and not file.trial:
                raise InputError(
                    f"{file.name}: Node {name} is asked for by {others[0]} and by {entry}; a Node is one agent's, by "
                    "the one value of its label robotkube.io/agent: name another Node, or try several agents on one "
                    "with trial: true beside agents"
                )
            others.append(entry)
    _roles(file)
    _homes(owners, file.name)
    return owners


def _homes(owners: Mapping[str, Sequence[AgentEntry]], file: str) -> None:
    """InputError for an agent that shares a Node and has another one, too, or that stands twice on one: its pods would
    have to be chosen by two labels."""
    nodes: dict[str, list[str]] = {}
    for name, entries in owners.items():
        for entry in entries:
            nodes.setdefault(entry.agent, []).append(name)
    for agent, names in nodes.items():
        shared = [name for name in names if len(owners[name]) > 1]
        if shared and len(names) > 1:
            raise InputError(
                f"{file}: agent {agent} shares Node {shared[0]} and stands on {', '.join(names)}; who shares a "
                "Node has that one alone, by one entry: leave the others out"
            )


def _roles(file: AgentsFile) -> None:
    roles: dict[str, str] = {}
    for entry in file.entries:
        if roles.setdefault(entry.agent, entry.role) != entry.role:
            raise InputError(f"{file.name}: {entry}: has role {entry.role}, another entry {roles[entry.agent]}; choose")


def _added(node: GivenNode, wanted: Mapping[str, str]) -> NodeChange | None:
    """The change of one Node from the labels that were added to those that are wanted; None when there is nothing to
    do."""
    before = node.added
    for key, value in wanted.items():
        present = node.labels.get(key)
        if present not in (None, value) and before.get(key) != present:
            raise InputError(
                f"Node {node.name}: has label {key}={present}, which was not added here; {value} is wanted: change "
                "agents.yaml, or take the label away"
            )
    theirs = {key for key in wanted if key in node.labels and node.labels[key] != before.get(key)}
    after = {key: value for key, value in wanted.items() if key not in theirs}
    labels: dict[str, str | None] = {key: value for key, value in after.items() if node.labels.get(key) != value}
    labels |= {key: None for key, value in before.items() if key not in wanted and node.labels.get(key) == value}
    recorded = json.dumps(after, sort_keys=True) if after else None
    annotations = {} if node.annotations.get(ADDED) == recorded else {ADDED: recorded}
    if not labels and not annotations:
        return None
    return NodeChange(node.name, labels, annotations, tuple(_notes(node, before, wanted)))


def _notes(node: GivenNode, before: Mapping[str, str], wanted: Mapping[str, str]) -> Iterator[str]:
    for key, value in before.items():
        if key not in wanted and key in node.labels and node.labels[key] != value:
            yield f"label {key}={node.labels[key]} stays: it was added as {value}, and somebody changed it"
