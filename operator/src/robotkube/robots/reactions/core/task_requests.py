"""The TaskDescription of an event, and the event of a TaskDescription."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.foundation.documents.core.times import time_ns, time_text
from robotkube.foundation.kubernetes.core.annotations import AGENTS_ANNOTATION, RENEWED_ANNOTATION
from robotkube.robots.reactions.core.settings import OperatorReactionSettings
from robotkube.robots.rules.core import START, Edge, task_name

AGENTS = "{agents}"


def event_task(
    requester: str, reaction: OperatorReactionSettings, edge: Edge, reason: str, parent: str = ""
) -> dict[str, Any]:
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
    """The merge patch that renews a task's lease at `now` (ns): an annotation, so the spec does not change."""
    return {"metadata": {"annotations": {RENEWED_ANNOTATION: time_text(now)}}}


def parent_of(task: Mapping[str, Any]) -> str:
    """The parent of a task: the one that launched the detector that made it; empty when none did."""
    return str(task.get("spec", {}).get("chain", {}).get("parent", ""))


def lease_seconds(task: Mapping[str, Any]) -> int | None:
    """The seconds of a task's lease; None when it has none."""
    seconds = task.get("spec", {}).get("lease", {}).get("seconds")
    return seconds if isinstance(seconds, int) else None


def event_of(task: Mapping[str, Any], requester: str) -> Edge | None:
    """The start edge of a task; None when it is another requester's or no event can be read from it."""
    spec = task.get("spec", {})
    metadata = task.get("metadata", {})
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


def _filled(value: Any, edge: Edge) -> Any:
    return list(edge.agents) if value == AGENTS else value
