"""The state of a task in a word or two, for lists that people read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.delivery.tasks.core.task_description import CONDITIONS
from robotkube.foundation.kubernetes.core.objects import is_withdrawn

ACCEPTED, READY = CONDITIONS[0], CONDITIONS[-1]
WITHDRAWN, REFUSED, NEW = "Withdrawn", "Refused", "New"


def task_state(task: Mapping[str, Any]) -> str:
    """The farthest condition that holds, or the reason of the one that does not."""
    if is_withdrawn(task):
        return WITHDRAWN
    conditions = {c["type"]: c for c in task.get("status", {}).get("conditions", [])}
    reached = NEW
    for kind in CONDITIONS:
        condition = conditions.get(kind)
        if condition is None:
            break
        if condition["status"] != "True":
            return f"{reached} ({condition['reason']})" if kind != ACCEPTED else f"{REFUSED} ({condition['reason']})"
        reached = kind
    return reached


def asked_for(spec: Mapping[str, Any]) -> str:
    """What a task asks for: the application, or whichever provides something."""
    return str(spec.get("application") or f"any that provides {spec.get('provides')}")
