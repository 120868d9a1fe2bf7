"""The keys `scope`, `operators` and `managers` of the manager's settings file (docs/reference/settings.md)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from robotkube.delivery.manager.core.placement.scopes import (
    DeclaredManager,
    Operators,
    Scope,
    excesses,
    left_out,
    overlaps,
    split_agents,
)
from robotkube.foundation.documents.core.patterns import NAME_OR_ALL, WORD
from robotkube.foundation.documents.core.reader import Reader

SECONDS_MAX = 86_400


def read_operators(reader: Reader, root: Mapping[str, Any], agents: Iterable[str]) -> Operators:
    """Read the manager's scope, and those of operators by the namespace of their tasks. Contradictions between them,
    the declared `agents` and the other managers are problems of the settings: such a manager must not begin."""
    scope = _scope(reader, root.get("scope"), "scope")
    declared = _declared(reader, root.get("operators"))
    managers = _managers(reader, root.get("managers"))
    names = list(agents)
    if not reader.problems:
        reader.problems += [*overlaps(managers), *(left_out(managers, names) if managers else [])]
        reader.problems += [*split_agents(scope, names), *excesses(scope, declared)]
    operators = {namespace: Scope(**parts) for namespace, parts in declared.items()}
    return Operators(scope, operators, tuple(managers))


def _scope(reader: Reader, value: Any, path: str) -> Scope:
    scope = reader.mapping(value or {}, path, ["agents", "namespaces", "applications"])
    keys = ("agents", "namespaces", "applications")
    return Scope(**{key: _names(reader, scope.get(key), f"{path}.{key}") for key in keys})


def _managers(reader: Reader, value: Any) -> list[DeclaredManager]:
    managers = []
    for index, item in enumerate(reader.sequence(value, "managers")):
        path = f"managers[{index}]"
        manager = reader.mapping(item, path, ["name", "scope"])
        name = reader.word(manager.get("name"), f"{path}.name", WORD)
        managers.append(DeclaredManager(name, _scope(reader, manager.get("scope"), f"{path}.scope")))
    return managers


def _declared(reader: Reader, value: Any) -> dict[str, dict[str, frozenset[str]]]:
    declared: dict[str, dict[str, frozenset[str]]] = {}
    for index, item in enumerate(reader.sequence(value, "operators")):
        path = f"operators[{index}]"
        operator = reader.mapping(item, path, ["namespace"], ["agents", "applications"])
        named = [key for key in ("agents", "applications") if key in operator]
        parts = {key: _names(reader, operator[key], f"{path}.{key}") for key in named}
        namespace = reader.word(operator.get("namespace"), f"{path}.namespace", WORD)
        if namespace in declared:
            reader.problems.append(f"{path}: operator {namespace!r} is declared twice; remove one")
        declared[namespace] = parts
    return declared


def _names(reader: Reader, value: Any, path: str) -> frozenset[str]:
    return frozenset(reader.word(item, path, NAME_OR_ALL) for item in reader.sequence(value, path))


def read_seconds(reader: Reader, value: Any, path: str) -> float:
    """Read a time in seconds: above 0, at most SECONDS_MAX."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= SECONDS_MAX:
        reader.problems.append(f"{path}: must be a number of seconds above 0, at most {SECONDS_MAX}")
        return 0.0
    return float(value)
