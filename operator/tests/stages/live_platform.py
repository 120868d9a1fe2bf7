"""A platform in memory for what is shown live: objects come, change and go, and the manager has plans."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from robotkube.errors import UnavailableError

SECOND = 1_000_000_000
NOW = 1_795_000_000 * SECOND  # 2026-11-18T11:06:40Z
AGENT, ROLE = "robotkube.io/agent", "robotkube.io/role"
Object = Mapping[str, Any]


class WatchInMemory:
    """A watch that gives what is there when it starts, and from then on what a test changes."""

    def __init__(self, reduce: Callable[[Object], Any], changed: Callable[[str, Any, Any], None]) -> None:
        self.synced = threading.Event()
        self.complaint = ""
        self.answers = True
        self._reduce, self._changed = reduce, changed
        self.objects: dict[str, Any] = {}

    def start(self) -> None:
        if not self.answers:
            self.complaint = "nobody answers"
            self.synced.wait = lambda timeout=None: False  # type: ignore[method-assign]
            return
        for key, value in self.objects.items():
            self._changed(key, None, value)
        self.synced.set()

    def stop(self) -> None:
        self.synced.clear()

    def put(self, item: Object | None, key: str = "") -> None:
        """An object as it is now; None: the one of `key` is gone."""
        key = f"{item['metadata'].get('namespace', '')}/{item['metadata']['name']}" if item else key
        before = self.objects.pop(key, None)
        if item is not None:
            self.objects[key] = self._reduce(item)
        if self.synced.is_set():
            self._changed(key, before, self.objects.get(key))


class LivePlatformInMemory:
    """See LivePlatform of robotkube.cli.live.feed."""

    def __init__(self) -> None:
        self.watches: dict[str, WatchInMemory] = {}
        self.plans: list[dict[str, Any]] = []
        self.metrics: dict[str, str] = {}
        self.pages = 0
        self.manager_answers = True
        self.now = NOW

    def watch_tasks(self, changed: Callable[[str, Any, Any], None], namespace: str = "") -> WatchInMemory:
        return self.watches.setdefault("tasks", WatchInMemory(dict, changed))

    def watch_of_agents(
        self, kind: str, reduce: Callable[[Object], Any], changed: Callable[[str, Any, Any], None]
    ) -> WatchInMemory:
        return self.watches.setdefault(kind, WatchInMemory(reduce, changed))

    def page(self, path: str) -> Mapping[str, Any]:
        assert path == "/plans"
        self.pages += 1
        if not self.manager_answers:
            raise UnavailableError("no endpoints for service manager")
        return {"plans": [dict(plan) for plan in self.plans]}

    def detector_metrics(self) -> Mapping[str, str]:
        return self.metrics

    def put(self, kind: str, item: Object | None, key: str = "") -> None:
        """An object as it is now, see WatchInMemory.put."""
        self.watches[kind].put(item, key)


def node(agent: str, ready: str = "True", since: str = "2026-11-18T11:00:00Z", role: str = "vehicle") -> Object:
    """A Node of an agent."""
    conditions = [{"type": "Ready", "status": ready, "lastTransitionTime": since}]
    return {"metadata": {"name": agent, "labels": {AGENT: agent, ROLE: role}}, "status": {"conditions": conditions}}


def pod(key: str, release: str, phase: str = "Running", ready: bool = True, restarts: int = 0) -> Object:
    """A pod of an agent's release."""
    namespace, name = key.split("/")
    ended = {"reason": "Error", "exitCode": 2, "finishedAt": "2026-11-18T11:00:00Z"}
    container = {"name": "main", "ready": ready, "restartCount": restarts, "state": {}}
    container |= {"lastState": {"terminated": ended}} if restarts else {}
    return {
        "metadata": {"namespace": namespace, "name": name, "labels": {"app.kubernetes.io/instance": release}},
        "spec": {"nodeName": namespace, "containers": [{"name": "main"}]},
        "status": {"phase": phase, "containerStatuses": [container]},
    }


def task(name: str, *conditions: tuple[str, str, str], rule: str = "lidar-proximity") -> Object:
    """A task of an event at 11:06:39.5, with conditions of type, status and reason."""
    listed = [{"type": kind, "status": status, "reason": why, "message": "words"} for kind, status, why in conditions]
    event = {"rule": rule, "id": "e1", "time": "2026-11-18T11:06:39.500000Z", "trace": "0" * 32}
    spec = {"application": "recording", "reason": "vehicle-00, vehicle-01 within 400 m", "requester": "eva"}
    created = "2026-11-18T11:06:40Z"
    return {
        "metadata": {"namespace": "cloud-0", "name": name, "creationTimestamp": created},
        "spec": spec | {"event": event},
        "status": {"conditions": listed},
    }


def plan(name: str, cause: str = "task", **values: Any) -> dict[str, Any]:
    """A plan of `/plans`; times in seconds after NOW."""
    times = dict.fromkeys(("proposed", "merged", "synced", "observed"))
    given = {key: NOW + round(value * SECOND) if key in times and value is not None else value
             for key, value in values.items()}  # fmt: skip
    return {
        "plan": name,
        "subject": "deploy(recording): vehicle-00, vehicle-01",
        "cause": cause,
        "tasks": ["cloud-0/one"],
        "events": ["e1"],
        "traces": [],
        "commit": None,
        "pull_request": None,
        "url": None,
        "created": ["cloud-0/recorder"],
        "changed": ["cloud-0/mqtt-bridge", "vehicle-00/mqtt-bridge"],
        "removed": [],
        "error": None,
        **times,
        **given,
    }
