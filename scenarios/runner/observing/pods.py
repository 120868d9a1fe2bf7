"""The lives of the agents' pods in a run, by the time of the watch event."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from scenarios.runner.inputs import PodOfRun
from scenarios.runner.observing.repeated_watch import RepeatedWatch
from scenarios.runner.platform.access import Access


class PodWatch(RepeatedWatch):
    """A watch of the pods in the agents' namespaces: when they appear, run, are ready and are gone."""

    def __init__(self, access: Access, namespaces: Sequence[str], progress: Callable[[str], None]) -> None:
        super().__init__("pods", progress)
        self._access = access
        self._namespaces = frozenset(namespaces)
        self._pods: dict[str, PodOfRun] = {}
        self.labels: dict[str, tuple[str, str, dict[str, str]]] = {}

    def pods(self) -> tuple[PodOfRun, ...]:
        """The lives seen so far."""
        with self._lock:
            return tuple(self._pods.values())

    def _watch_once(self) -> None:
        """One watch; pods that went between it and the one before are noted as gone now."""
        listed = self._access.core.list_pod_for_all_namespaces()
        present = {pod.metadata.uid for pod in listed.items}
        for pod in listed.items:
            self._note("MODIFIED", pod)
        for uid in [pod.uid for pod in self.pods() if pod.deleted is None and pod.uid not in present]:
            self._put(replace(self._pods[uid], deleted=time.time_ns()))
        listing = self._access.core.list_pod_for_all_namespaces
        for kind, pod in self._events(listing, since=listed.metadata.resource_version):
            self._note(kind, pod)

    def _note(self, kind: str, pod: Any) -> None:
        now = time.time_ns()
        data = pod.metadata
        self.labels[data.uid] = (data.namespace, data.name, dict(data.labels or {}))
        if data.namespace not in self._namespaces:
            return
        known = self._pods.get(data.uid) or PodOfRun(data.namespace, data.name, data.uid, now)
        if kind == "DELETED":
            known = replace(known, deleted=known.deleted or now)
        if pod.status.phase == "Running":
            known = replace(known, running=known.running or now)
        if any(c.type == "Ready" and c.status == "True" for c in pod.status.conditions or []):
            known = replace(known, ready=known.ready or now)
        self._put(known)

    def _put(self, pod: PodOfRun) -> None:
        with self._lock:
            self._pods[pod.uid] = pod
