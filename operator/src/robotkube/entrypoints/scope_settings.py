"""The keys `scope` and `operators` of the manager's settings file (docs/reference/settings.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from robotkube.domain.documents import Reader
from robotkube.domain.scopes import Operators, Scope
from robotkube.entrypoints import settings as files

NAME_OR_ALL = re.compile(r"[*]|[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?", re.ASCII)
SECONDS_MAX = 86_400


def read_operators(reader: Reader, root: Mapping[str, Any]) -> Operators:
    """The manager's scope, and those of operators by the namespace of their tasks."""
    found = reader.mapping(root.get("scope") or {}, "scope", ["agents", "namespaces", "applications"])
    parts = {key: _names(reader, found.get(key), f"scope.{key}") for key in ("agents", "namespaces", "applications")}
    return Operators(Scope(**parts), _declared(reader, root.get("operators")))


def _declared(reader: Reader, value: Any) -> dict[str, Scope]:
    found: dict[str, Scope] = {}
    for index, item in enumerate(reader.sequence(value, "operators")):
        path = f"operators[{index}]"
        operator = reader.mapping(item, path, ["namespace"], ["agents", "applications"])
        named = [key for key in ("agents", "applications") if key in operator]
        parts = {key: _names(reader, operator[key], f"{path}.{key}") for key in named}
        found[reader.word(operator.get("namespace"), f"{path}.namespace", files.WORD)] = Scope(**parts)
    return found


def _names(reader: Reader, value: Any, path: str) -> frozenset[str]:
    return frozenset(reader.word(item, path, NAME_OR_ALL) for item in reader.sequence(value, path))


def read_seconds(reader: Reader, value: Any, path: str) -> float:
    """A time above 0, at most SECONDS_MAX."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= SECONDS_MAX:
        reader.problems.append(f"{path}: must be a number of seconds above 0, at most {SECONDS_MAX}")
        return 0.0
    return float(value)
