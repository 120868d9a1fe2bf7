"""The way of a task on one line: event, task, pull request, main, observed, each with its time after the event."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.cli.live.moments import conditions, event_time
from robotkube.delivery.manager.adapters.pod_states import read_time_ns

STAGES = ("proposed", "merged", "observed")


@dataclass(frozen=True)
class TaskWay:
    """How far a task has come: `stages` with their times (ns since 1970) in their order, `awaits` the next one, empty
    when there is none; `problem`: why it does not go on."""

    task: str
    begin: int
    stages: tuple[tuple[str, int], ...]
    awaits: str
    problem: str = ""


def way(key: str, task: Mapping[str, Any], plans: Iterable[Mapping[str, Any]]) -> TaskWay | None:
    """The way of a task that stands, by the newest plan that answers it; None when nothing says when it began."""
    begin = event_time(task) or read_time_ns(task["metadata"].get("creationTimestamp"))
    if begin is None:
        return None
    answering = [plan for plan in plans if key in plan["tasks"] and plan["cause"] == "task"]
    times = answering[-1] if answering else {}
    stages = tuple((stage, times[stage]) for stage in STAGES if times.get(stage))
    accepted = conditions(task).get("Accepted", {})
    refused = f"{accepted.get('reason')}: {accepted.get('message')}" if accepted.get("status") == "False" else ""
    awaits = "" if refused else next((stage for stage in STAGES if not times.get(stage)), "")
    return TaskWay(key, begin, stages, awaits, refused)
