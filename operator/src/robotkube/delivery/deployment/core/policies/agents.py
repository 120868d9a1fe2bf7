"""policies/agents.yaml: reserved agents that are enrolled, each with its role.

    agents:
    - {name: vehicle-16, role: vehicle}

The installation reserves names for agents to come (charts/robotkube, values agents, `reserved: true`): everything that
they need in the cluster is there, and their accounts at the broker are shut. Main opens them. Without the file nobody
is enrolled. Always read from main.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping

PATH = "policies/agents.yaml"
ROLES = ("cloud", "edge", "roadside", "vehicle")
VALUES = "(charts/robotkube, values agents)"


def read_enrolled(text: str | None, path: str = PATH) -> dict[str, str]:
    """Agent -> role, nobody without a text; DocumentError names the key and what may stand there."""
    if text is None:
        return {}
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", [], ["agents"])
    enrolled: dict[str, str] = {}
    for index, item in enumerate(reader.sequence(document.get("agents"), "agents")):
        where = f"agents[{index}]"
        entry = reader.mapping(item, where, ["name", "role"])
        name = reader.word(entry.get("name"), f"{where}.name", NAME)
        if name in enrolled:
            reader.problems.append(f"{where}.name: {name} stands twice; keep one of them")
        enrolled[name] = _role(reader, entry.get("role"), f"{where}.role")
    reader.finish()
    return enrolled


def write_enrolled(enrolled: Mapping[str, str]) -> str:
    """The text of the file, sorted by agent."""
    return write_mapping({"agents": [{"name": name, "role": role} for name, role in sorted(enrolled.items())]})


def read_declared(reader: Reader, value: Any, path: str) -> tuple[str, str, str]:
    """Name, role and namespace of an agent in a process's settings; the role of a reserved one is empty."""
    agent = reader.mapping(value, path, ["name", "namespace"], ["role", "reserved", "records"])
    reserved = agent.get("reserved", False)
    if not isinstance(reserved, bool) or reserved is ("role" in agent):
        reader.problems.append(f"{path}: must have either a role or reserved: true")
    name, namespace = (reader.word(agent.get(key), f"{path}.{key}", NAME) for key in ("name", "namespace"))
    return name, "" if reserved is True else reader.word(agent.get("role"), f"{path}.role", NAME), namespace


def not_reserved(enrolled: Mapping[str, str], reserved: Collection[str], declared: Collection[str]) -> list[str]:
    """The entries that enroll nobody: a sentence for each, with the way out. `declared`: agents that the values of the
    platform's chart declare, reserved ones among them."""
    known = ", ".join(sorted(reserved)) or "none"
    return [
        f"{PATH}: agents[{index}].name: {name} is declared by the chart's values already; take it out here"
        if name in declared
        else f"{PATH}: agents[{index}].name: {name} is not reserved; there are: {known}. Use one of them, or reserve "
        f"the name {VALUES}"
        for index, name in enumerate(enrolled)
        if name not in reserved
    ]


def _role(reader: Reader, value: Any, path: str) -> str:
    if value is not None and value not in ROLES:  # one that is missing is said already
        reader.problems.append(f"{path}: unknown role {value!r}; use one of {', '.join(ROLES)}")
    return str(value)
