"""The TaskDescription that an event asks for, and the event that a TaskDescription was made for."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from robotkube.domain.reaction_settings import OperatorReaction
from robotkube.domain.rules import START, Edge, task_name

AGENTS = "{agents}"
AGENTS_ANNOTATION = "robotkube.io/agents"
RENEWED_ANNOTATION = "robotkube.io/lease-renewed"


def demand(requester: str, reaction: OperatorReaction, edge: Edge, reason: str, parent: str = "") -> dict[str, Any]:
    """The TaskDescription of a start edge (docs/reference/contracts.md); the same edge always gives the same object.

    `reason` is the rule's, `parent` the task that launched the detector."""
    lease = {"lease": {"seconds": reaction.lease_seconds}} if reaction.lease_seconds else {}
    chain = {"chain": {"parent": parent}} if parent else {}
    return {
        "apiVersion": "robotkube.io/v1alpha1",
        "kind": "TaskDescription",
        "metadata": {"name": task_name(edge), "annotations": {AGENTS_ANNOTATION: " ".join(edge.agents)}},
        "spec": {
            "requester": requester,
            "event": {
                "rule": edge.rule,
                "id": edge.id,
                "time": time_text(edge.time),
                "stamp": time_text(edge.stamp),
                "trace": edge.trace,
            },
            "reason": reason.replace(AGENTS, ", ".join(edge.agents)),
            "application": reaction.application,
            "parameters": {key: _filled(value, edge) for key, value in reaction.parameters.items()},
            **lease,
            **chain,
        },
    }


def renewal(now: int) -> dict[str, Any]:
    """What renews a task's lease at `now` (ns), as a merge patch: an annotation, so the spec does not change."""
    return {"metadata": {"annotations": {RENEWED_ANNOTATION: time_text(now)}}}


def parent_of(task: Mapping[str, Any]) -> str:
    """The task that launched the detector that made this one; empty when none did."""
    return str(task.get("spec", {}).get("chain", {}).get("parent", ""))


def lease_seconds(task: Mapping[str, Any]) -> int | None:
    """How long a task counts without renewal; None when it has no lease."""
    seconds = task.get("spec", {}).get("lease", {}).get("seconds")
    return seconds if isinstance(seconds, int) else None


def event_of(task: Mapping[str, Any], requester: str) -> Edge | None:
    """The start edge that `task` was made for; None when it is another requester's or no event can be read from it."""
    spec, metadata = task.get("spec", {}), task.get("metadata", {})
    agents = str(metadata.get("annotations", {}).get(AGENTS_ANNOTATION, "")).split()
    event = spec.get("event", {})
    if spec.get("requester") != requester or metadata.get("deletionTimestamp") or not agents:
        return None
    try:
        return Edge(
            rule=event["rule"],
            edge=START,
            agents=tuple(agents),
            id=event["id"],
            trace=event["trace"],
            time=time_ns(event["time"]),
            stamp=time_ns(event["stamp"]),
        )
    except (KeyError, ValueError):
        return None


def time_text(time: int) -> str:
    """RFC 3339 in UTC with microseconds, of ns since 1970."""
    seconds, rest = divmod(time, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1000:06d}Z"


def time_ns(text: str) -> int:
    """ns since 1970 of an RFC 3339 time in UTC; ValueError when it is none."""
    moment = datetime.fromisoformat(text)
    return int(moment.replace(microsecond=0).timestamp()) * 1_000_000_000 + moment.microsecond * 1000


def _filled(value: Any, edge: Edge) -> Any:
    return list(edge.agents) if value == AGENTS else value
