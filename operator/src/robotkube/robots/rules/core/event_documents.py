"""Edges as JSON documents, in the one form of `/events` of a detector and of `robotkube rule test`.

docs/reference/contracts.md, "Measurements offered by the event detector".
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.robots.rules.core.events import Edge

SERIES_MAX = 100
BYTES_MAX = 64


def edge_document(edge: Edge) -> dict[str, Any]:
    """The document of an edge; times in ns since 1970. Of long series it has the first SERIES_MAX values."""
    return {
        "id": edge.id,
        "rule": edge.rule,
        "edge": edge.edge,
        "agents": list(edge.agents),
        "time": edge.time,
        "stamp": edge.stamp,
        "distance_m": edge.distance_m,
        "trace": edge.trace,
        "detail": {name: plain(value) for name, value in edge.detail.items()},
        "causes": [
            {"topic": cause.topic, "stamp": cause.stamp, "values": plain(dict(cause.values))} for cause in edge.causes
        ],
    }


def is_edge(value: object) -> bool:
    """Return whether the value is such a document, as far as `explained` needs it."""
    if not isinstance(value, Mapping) or not all(isinstance(value.get(key), str) for key in ("id", "rule", "edge")):
        return False
    agents, causes, detail = (
        value.get(key) or kind() for key, kind in (("agents", list), ("causes", list), ("detail", dict))
    )
    return (
        {"stamp", "time"} <= set(value)
        and isinstance(detail, Mapping)
        and isinstance(agents, list)
        and all(isinstance(agent, str) for agent in agents)
        and isinstance(causes, list)
        and all(
            isinstance(cause, Mapping) and {"topic", "stamp"} <= set(cause) and isinstance(cause.get("values"), Mapping)
            for cause in causes
        )
    )


def plain(value: Any) -> Any:
    """A field's value as JSON has it: numbers that JSON has not and bytes as text."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (array, tuple, list)):
        return [plain(item) for item in value[:SERIES_MAX]]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, (bytes, bytearray, memoryview)):
        return bytes(value[:BYTES_MAX]).hex()
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)


def explained(edges: Sequence[Mapping[str, Any]]) -> list[str]:
    """The edges of one event in words: what was compared, and the messages it came from."""
    lines: list[str] = []
    for edge in edges:
        agents = ", ".join(edge.get("agents") or ()) or "nobody"
        verb = "began" if edge["edge"] == "start" else "ended"
        lines.append(f"{edge['rule']} {verb} for {agents} at {edge['stamp']}, noticed at {edge['time']}")
        lines += [f"  {name} = {value}" for name, value in sorted((edge.get("detail") or {}).items())]
        causes = edge.get("causes") or ()
        lines += [f"  {cause['topic']} at {cause['stamp']}: {_values(cause['values'])}" for cause in causes]
        if not causes:
            lines.append("  no message: the time alone, or settings that changed")
    return lines


def _values(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in values.items()) or "it came"
