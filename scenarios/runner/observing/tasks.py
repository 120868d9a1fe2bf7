"""The lives of the tasks in a run: when they came and went and their conditions changed, by the time of the watch
event."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from scenarios.runner.inputs import TaskCondition, TaskLife
from scenarios.runner.observing.repeated_watch import RepeatedWatch
from scenarios.runner.platform.access import TASKS, Access

CONDITIONS_MAX = 1000  # of one task


class TaskWatch(RepeatedWatch):
    """A watch of all tasks from `start` to `stop`."""

    def __init__(self, access: Access, progress: Callable[[str], None]) -> None:
        super().__init__("tasks", progress)
        self._access = access
        self._lives: dict[str, TaskLife] = {}

    def lives(self) -> tuple[TaskLife, ...]:
        """The lives seen so far, in order of their beginnings."""
        with self._lock:
            return tuple(sorted(self._lives.values(), key=lambda life: life.created))

    def _watch_once(self) -> None:
        """One watch; tasks that went between it and the one before are noted as gone now."""
        listing = self._access.objects.list_cluster_custom_object
        listed = listing(*TASKS)
        present = {item["metadata"]["uid"] for item in listed["items"]}
        for item in listed["items"]:
            self.note("MODIFIED", item)
        with self._lock:
            for uid in [uid for uid, life in self._lives.items() if life.deleted is None and uid not in present]:
                self._lives[uid] = replace(self._lives[uid], deleted=time.time_ns())
        for kind, task in self._events(listing, *TASKS, since=listed["metadata"]["resourceVersion"]):
            self.note(kind, task)

    def note(self, kind: str, task: Mapping[str, Any]) -> None:
        """One event: a task as the API server has it, ADDED, MODIFIED or DELETED."""
        if kind not in ("ADDED", "MODIFIED", "DELETED"):
            raise ValueError(f"the API server ended the watch: {kind}")
        now = time.time_ns()
        data = task["metadata"]
        with self._lock:
            known = self._lives.get(data["uid"]) or _born(task, now)
            changed = tuple(_changed(known, task, now))
            known = replace(known, conditions=(*known.conditions, *changed)[-CONDITIONS_MAX:])
            if kind == "DELETED":
                known = replace(known, deleted=known.deleted or now)
            self._lives[data["uid"]] = known


def _born(task: Mapping[str, Any], now: int) -> TaskLife:
    data = task["metadata"]
    spec = task.get("spec", {})
    parent = str((spec.get("chain") or {}).get("parent", ""))
    return TaskLife(f"{data['namespace']}/{data['name']}", now, spec, parent)


def _changed(known: TaskLife, task: Mapping[str, Any], now: int) -> Iterator[TaskCondition]:
    """Conditions that differ from when they were last seen."""
    last = {condition.type: condition for condition in known.conditions}
    for one in task.get("status", {}).get("conditions", []):
        condition = TaskCondition(now, one["type"], one["status"], one.get("reason", ""), one.get("message", ""))
        before = last.get(condition.type)
        if before is None or replace(before, time=now) != condition:
            yield condition
