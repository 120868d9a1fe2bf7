"""A line for each component of an installation when it is ready, and what the others hang with, as their pods and
events say it.

with InstallationWatch(api, ["robotkube", "robotkube-gate", "argocd"], say) as followed:
    install()
    followed.lines.hanging()
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from kubernetes.client import ApiClient

from robotkube.cli.live.rollouts import DEPLOYMENT, JOB, STATEFUL_SET, describe_rollout, is_installed, rolled_out
from robotkube.errors import RobotKubeError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.foundation.kubernetes.adapters.client import ResourceWatch, call
from robotkube.registry.suites.core.pod_descriptions import describe_pod, describe_warnings, pod_ready

NAME, PART = "app.kubernetes.io/name", "app.kubernetes.io/part-of"
PLATFORM, ARGOCD = "robotkube", "argocd"  # what workloads are part of
POD = "Pod"
READY, DONE, NOT_READY = "ready", "done", "not ready"
WORKLOADS = f"{NAME},{PART} in ({PLATFORM},{ARGOCD})"
WATCHED = (
    (DEPLOYMENT, "/apis/apps/v1/namespaces/{}/deployments", WORKLOADS),
    (STATEFUL_SET, "/apis/apps/v1/namespaces/{}/statefulsets", WORKLOADS),
    (JOB, "/apis/batch/v1/namespaces/{}/jobs", WORKLOADS),
    (POD, "/api/v1/namespaces/{}/pods", NAME),  # those of Argo CD's manifests do not say what they are part of
)
SILENT_SECONDS_MAX = 30.0  # then it is said what hangs, once for each reason
POLL_SECONDS = 1.0
END_SECONDS_MAX = 5.0
SYNC_SECONDS_MAX = 15.0
EVENTS_MAX = "500"
Object = Mapping[str, Any]
Events = Callable[[str, str], Sequence[Object]]


@dataclass(frozen=True)
class ComponentLine:
    """What there is to say of one component: READY or DONE after `seconds`, or NOT_READY with `reasons`."""

    component: str
    state: str
    seconds: float
    reasons: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The line as a sentence."""
        if self.state == NOT_READY:
            return f"{self.component} is not ready: {'; '.join(self.reasons)}"
        return f"{self.component}: {self.state} after {self.seconds:.1f} s"

    def document(self) -> dict[str, Any]:
        """The line for programs."""
        seconds = round(self.seconds, 1)
        return {"component": self.component, "state": self.state, "seconds": seconds, "reasons": list(self.reasons)}


class ComponentLines:
    """What `say` is told of components; `events` are those of an object (namespace, name), `monotonic` a clock in
    seconds. Safe from any thread."""

    def __init__(self, say: Callable[[ComponentLine], None], events: Events, monotonic: Callable[[], float]) -> None:
        self._say, self._events, self._monotonic = say, events, monotonic
        self._began = self._spoken = monotonic()
        self._pods: dict[tuple[str, str], Object] = {}
        self._workloads: dict[tuple[str, str, str], Object] = {}
        self._unready: set[tuple[str, str, str]] = set()
        self._reasons: set[str] = set()
        self._lock = threading.Lock()

    def saw(self, item: Object) -> None:
        """A pod, a Deployment, a StatefulSet or a Job (`kind`) is there as it is now."""
        metadata = item["metadata"]
        if NAME not in metadata.get("labels", {}):
            return
        if "deletionTimestamp" in metadata:
            self.gone(item)
            return
        with self._lock:
            if item["kind"] == POD:
                self._pods[metadata["namespace"], metadata["name"]] = item
            elif is_installed(item):
                self._saw_workload((item["kind"], metadata["namespace"], metadata["name"]), item)

    def gone(self, item: Object) -> None:
        """It is there no more, or goes."""
        metadata = item["metadata"]
        with self._lock:
            if item["kind"] == POD:
                self._pods.pop((metadata["namespace"], metadata["name"]), None)
            else:
                key = item["kind"], metadata["namespace"], metadata["name"]
                self._workloads.pop(key, None)
                self._unready.discard(key)

    def look(self) -> None:
        """Say what hangs, when nothing was said for a while."""
        with self._lock:
            if self._monotonic() - self._spoken < SILENT_SECONDS_MAX:
                return
            self._spoken = self._monotonic()
        for line in self.hanging():
            if line.words not in self._reasons:
                self._reasons.add(line.words)
                self._say(line)

    def hanging(self) -> tuple[ComponentLine, ...]:
        """A line for each component that is not ready: what its pods' containers wait for, their last warnings, and
        where there is no pod what speaks against one."""
        with self._lock:
            waiting = [(workload, self._waiting_pods(workload)) for workload in self._waiting()]
        seconds = self._monotonic() - self._began
        return tuple(
            ComponentLine(_component(workload), NOT_READY, seconds, tuple(self._described(workload, pods)))
            for workload, pods in waiting
        )

    def components(self, part: str) -> int:
        """How many there are that are part of PLATFORM or ARGOCD."""
        with self._lock:
            return sum(item["metadata"]["labels"].get(PART) == part for item in self._workloads.values())

    def is_waiting(self) -> bool:
        """Return whether one is not ready."""
        with self._lock:
            return bool(self._waiting())

    def _saw_workload(self, key: tuple[str, str, str], item: Object) -> None:
        self._workloads[key] = item
        if not rolled_out(item):
            self._unready.add(key)
        elif key in self._unready:
            self._unready.remove(key)
            self._spoken = self._monotonic()
            state = DONE if item["kind"] == JOB else READY
            self._say(ComponentLine(_component(item), state, self._spoken - self._began))

    def _waiting(self) -> list[Object]:
        return sorted((self._workloads[key] for key in self._unready), key=_component)

    def _waiting_pods(self, workload: Object) -> list[Object]:
        """The pods by which it is not ready: a Job's has to end."""
        where = workload["metadata"]["namespace"], _component(workload)
        own = [pod for pod in self._pods.values() if (pod["metadata"]["namespace"], _component(pod)) == where]
        return [
            pod
            for pod in own
            if (pod.get("status") or {}).get("phase") != "Succeeded" and (workload["kind"] == JOB or not pod_ready(pod))
        ]

    def _described(self, workload: Object, pods: Sequence[Object]) -> Iterator[str]:
        for pod in pods:
            yield from describe_pod(pod, self._events_of(pod))
        if not pods:
            yield from describe_rollout(workload)
            yield from describe_warnings(self._events_of(workload))

    def _events_of(self, item: Object) -> Sequence[Object]:
        return self._events(item["metadata"]["namespace"], item["metadata"]["name"])


def _component(item: Object) -> str:
    return str(item["metadata"]["labels"][NAME])


class InstallationWatch:
    """Lines about platform and Argo CD in these namespaces, by the API, from `with` to its end. When they cannot be
    followed no line is said, and nothing fails by that."""

    def __init__(self, api: ApiClient, namespaces: Collection[str], say: Callable[[ComponentLine], None]) -> None:
        self._api = api
        self._ended = threading.Event()
        self._looking = threading.Thread(target=self._look, name="component lines", daemon=True)
        self.lines = ComponentLines(say, self._events, time.monotonic)
        self._watches = [
            ResourceWatch(api, path.format(namespace), selector, _of_kind(kind), self._changed)
            for namespace in dict.fromkeys(namespaces)
            for kind, path, selector in WATCHED
        ]

    def __enter__(self) -> InstallationWatch:
        for watch in self._watches:
            watch.start()
        self._looking.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        for watch in self._watches:
            watch.stop()
        self._looking.join(END_SECONDS_MAX)

    def wait_for_first_look(self, seconds: float = SYNC_SECONDS_MAX) -> None:
        """Return when everything was seen once; UnavailableError when it is not seen in this time."""
        end = time.monotonic() + seconds
        for watch in self._watches:
            if not watch.synced.wait(max(0.0, end - time.monotonic())):
                raise UnavailableError(f"what is installed cannot be watched: {watch.complaint}")

    @property
    def complaint(self) -> str:
        """Why what is known may be old; empty when it is not."""
        return next((watch.complaint for watch in self._watches if watch.complaint), "")

    def _changed(self, key: str, before: Any, now: Any) -> None:
        if self._ended.is_set():
            return
        if now is None:
            self.lines.gone(before)
        else:
            self.lines.saw(now)

    def _look(self) -> None:
        while not self._ended.wait(POLL_SECONDS):
            self.lines.look()

    def _events(self, namespace: str, name: str) -> Sequence[Object]:
        """Events of an object; none when they cannot be asked for."""
        query = [("fieldSelector", f"involvedObject.name={name}"), ("limit", EVENTS_MAX)]
        try:
            answer = call(self._api, "GET", f"/api/v1/namespaces/{namespace}/events", query)
            items: Sequence[Object] = read_json_shortened(answer.data)["items"]
        except (RobotKubeError, KeyError, ValueError):
            return ()
        return items


def _of_kind(kind: str) -> Callable[[Object], Object]:
    """Says its kind, which objects of a list do not; without what changes and is not needed."""

    def reduced(item: Object) -> Object:
        return {"kind": kind, "metadata": _named(item), "spec": _wanted(item), "status": item.get("status") or {}}

    return reduced


def _named(item: Object) -> Object:
    kept = ("namespace", "name", "generation", "labels", "annotations", "deletionTimestamp")
    return {key: value for key, value in item["metadata"].items() if key in kept}


def _wanted(item: Object) -> Object:
    kept = ("replicas", "updateStrategy")
    return {key: value for key, value in (item.get("spec") or {}).items() if key in kept}
