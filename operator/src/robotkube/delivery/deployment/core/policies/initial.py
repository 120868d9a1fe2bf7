"""The initial configuration: what the catalogue gives to agents of a role, plus and minus what people decided."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping

PATH = "policies/initial.yaml"


@dataclass(frozen=True)
class Addition:
    """An application for every agent of a role, or for named agents."""

    application: str
    role: str = ""
    agents: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Removal:
    """An application that named agents do not get."""

    application: str
    agents: tuple[str, ...]


@dataclass(frozen=True)
class InitialPolicy:
    """The content of policies/initial.yaml."""

    add: tuple[Addition, ...] = ()
    remove: tuple[Removal, ...] = ()


def read_initial_policy(text: str, path: str = PATH) -> InitialPolicy:
    """The policy in `text`: `add: [{application, forRole | agents, parameters}]`, `remove: [{application, agents}]`;
    both may be missing."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", [], ["add", "remove"])
    add = [_addition(reader, item, f"add[{i}]") for i, item in enumerate(reader.sequence(document.get("add"), "add"))]
    remove = [
        _removal(reader, item, f"remove[{i}]")
        for i, item in enumerate(reader.sequence(document.get("remove"), "remove"))
    ]
    reader.finish()
    return InitialPolicy(tuple(add), tuple(remove))


def _addition(reader: Reader, item: Any, path: str) -> Addition:
    addition = reader.mapping(item, path, ["application"], ["forRole", "agents", "parameters"])
    if ("forRole" in addition) == ("agents" in addition):
        reader.problems.append(f"{path}: needs either `forRole` or `agents`")
    parameters = addition.get("parameters", {})
    if not isinstance(parameters, Mapping):
        reader.problems.append(f"{path}.parameters: must be a mapping")
        parameters = {}
    return Addition(
        reader.word(addition.get("application"), f"{path}.application", NAME),
        reader.word(addition.get("forRole"), f"{path}.forRole", NAME, default=""),
        _agents(reader, addition, path),
        parameters,
    )


def _removal(reader: Reader, item: Any, path: str) -> Removal:
    removal = reader.mapping(item, path, ["application", "agents"])
    return Removal(reader.word(removal.get("application"), f"{path}.application", NAME), _agents(reader, removal, path))


def _agents(reader: Reader, entry: Mapping[str, Any], path: str) -> tuple[str, ...]:
    names = reader.sequence(entry.get("agents"), f"{path}.agents")
    return tuple(reader.text(name, f"{path}.agents", NAME) for name in names)
