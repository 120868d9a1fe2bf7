"""The cluster as the manager reads it, kept up to date by one watch per kind; and the statuses of tasks it writes.

A watch lists, then receives the changes from there; one that ends in order is resumed where it ended, anything else
(lost connection, expired position) begins with a list again after a pause. Until the first list of every kind is
complete nothing may be decided: see `wait_until_synced`.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from kubernetes import client

from robotkube.delivery.manager.adapters.pod_states import placed, read_pod, read_time_ns
from robotkube.delivery.manager.core.observation import ApplicationState, PodState
from robotkube.delivery.manager.core.placement.capacity import Resources, read_resources
from robotkube.delivery.manager.core.placement.placement import NodeState
from robotkube.delivery.manager.core.updates.probe_answers import ProbeLoss, ProbeLosses
from robotkube.delivery.manager.core.updates.rule_events import RuleEvent, RuleEvents
from robotkube.delivery.tasks.core.holds import node_hold
from robotkube.delivery.tasks.core.task_description import GROUP, PLURAL, VERSION
from robotkube.errors import UnavailableError
from robotkube.foundation.kubernetes.adapters.client import CONFLICT, Object, ResourceWatch, send
from robotkube.foundation.kubernetes.core.node_agents import AGENT, NodeAgent, node_agents
from robotkube.foundation.kubernetes.core.objects import is_withdrawn
from robotkube.writes import writes

EVENT_NOTE_BYTES_MAX = 1024
EVENTS_PATH = "/apis/events.k8s.io/v1/namespaces/{namespace}/events"
CONDITIONS_MAX = 5
CONDITION_CHARACTERS_MAX = 500
TASKS_PATH = f"/apis/{GROUP}/{VERSION}/{PLURAL}"
PODS_PATH = "/api/v1/pods"
PLAN_ANNOTATION = f"{GROUP}/plan"

log = logging.getLogger(__name__)


class KubernetesCluster:
    """The ports TaskStore and Cluster. `wake` gets `tasks`, `nodes` or `applications` when something that
    matters changed; `now` is the wall clock in seconds. Tasks and pods are read in `namespaces` (none: in all); `home`
    is the platform's namespace, where Events about Nodes are written."""

    def __init__(
        self,
        api: client.ApiClient,
        argocd_namespace: str,
        wake: Callable[[str], None],
        now: Callable[[], float],
        namespaces: Collection[str] = (),
        home: str = "default",
    ) -> None:
        self._api = api
        self._wake = wake
        self._now = now
        self._home = home
        self._events = RuleEvents()
        self._losses = ProbeLosses()
        applications = f"/apis/argoproj.io/v1alpha1/namespaces/{argocd_namespace}/applications"
        self._tasks = [
            ResourceWatch(api, path, "", dict, self._task_changed) for path in _paths(TASKS_PATH, namespaces)
        ]
        self._nodes = ResourceWatch(api, "/api/v1/nodes", AGENT, read_nodes, self._node_changed)
        self._applications = ResourceWatch(api, applications, "", read_application, self._application_changed)
        self._pods = [
            ResourceWatch(api, path, AGENT, read_pod, self._pod_changed) for path in _paths(PODS_PATH, namespaces)
        ]
        self._watches = (*self._tasks, self._nodes, self._applications, *self._pods)

    def start(self) -> None:
        """Begin to watch."""
        for watch in self._watches:
            watch.start()

    def stop(self) -> None:
        """End the watches."""
        for watch in self._watches:
            watch.stop()

    def wait_until_synced(self, seconds: float) -> bool:
        """Wait until every kind was listed; False when `seconds` are over before."""
        each = seconds / len(self._watches)
        return all(watch.synced.wait(each) for watch in self._watches)

    def complaints(self) -> list[str]:
        """Complaints, one sentence per watch that does not run."""
        return [watch.complaint for watch in self._watches if watch.complaint]

    def _task_changed(self, key: str, before: Object | None, now: Object | None) -> None:
        if _demand(before) != _demand(now):
            if before is None and now is not None:
                self._events.note(now)
            if before is not None and (now is None or is_withdrawn(now)):
                self._events.end(before)
            self._wake("tasks")

    def rule_events(self) -> Sequence[RuleEvent]:
        """The events that tasks brought since the process was started, and those of tasks that were there."""
        return self._events.all()

    def _node_changed(self, key: str, before: Any, now: Any) -> None:
        self._wake("nodes")

    def _application_changed(self, key: str, before: Any, now: Any) -> None:
        self._wake("applications")

    def _pod_changed(self, key: str, before: PodState | None, now: PodState | None) -> None:
        lost = self._losses.note(before, now, int(self._now() * 1e9))
        if lost or placed(before) != placed(now):
            self._wake("applications")

    def probe_losses(self) -> Sequence[ProbeLoss]:
        """The losses of readiness since the process was started."""
        return self._losses.all()

    def tasks(self) -> Sequence[Object]:
        """All TaskDescriptions of the namespaces."""
        tasks = {key: task for watch in self._tasks for key, task in watch.values().items()}
        return [tasks[key] for key in sorted(tasks)]

    @writes("status")
    def patch_status(self, namespace: str, name: str, status: Object) -> bool:
        """Merge into the task's status; False when the task is gone."""
        path = f"/apis/{GROUP}/{VERSION}/namespaces/{namespace}/{PLURAL}/{name}/status"
        try:
            send(self._api, "PATCH", path, {"status": status}, "application/merge-patch+json")
        except KeyError:
            return False
        return True

    @writes("task")
    def withdraw(self, namespace: str, name: str) -> bool:
        """Delete a task; False when it is gone already."""
        try:
            send(self._api, "DELETE", f"/apis/{GROUP}/{VERSION}/namespaces/{namespace}/{PLURAL}/{name}", {})
        except KeyError:
            return False
        return True

    @writes("event")
    def report_on_task(self, task: Object, reason: str, text: str) -> None:
        """Write a warning on the task as an Event. Its name is made from task, reason and text: a second one is a
        conflict, since the Event is there already."""
        self._write_event(task_event(task, reason, text, datetime.fromtimestamp(self._now(), UTC)))

    @writes("event")
    def report_on_node(self, node: str, reason: str, text: str) -> None:
        """Write a warning about a Node as an Event in the platform's namespace: a Node has none, and may not be
        written. A second one is a conflict, as with tasks; it does not matter which manager writes it."""
        regarding = {"apiVersion": "v1", "kind": "Node", "namespace": self._home, "name": node, "uid": node}
        self._write_event(_event(regarding, "Watching", reason, text, datetime.fromtimestamp(self._now(), UTC)))

    def _write_event(self, event: dict[str, Any]) -> None:
        path = EVENTS_PATH.format(namespace=event["metadata"]["namespace"])
        try:
            send(self._api, "POST", path, event)
        except UnavailableError as error:
            if not (isinstance(error.__cause__, client.ApiException) and error.__cause__.status == CONFLICT):
                raise

    def nodes(self) -> Sequence[NodeState]:
        """Nodes of agents; one that is several agents' stands there for each of them."""
        return [state for states in self._nodes.values().values() for state in states]

    def applications(self) -> Mapping[str, ApplicationState]:
        """Argo CD Applications by name."""
        return {state.name: state for state in self._applications.values().values()}

    def pods(self, release: str) -> Sequence[PodState]:
        """Pods of a release."""
        nodes = {node.name: node for node in self.nodes()}
        now_ns = int(self._now() * 1e9)
        return [
            _with_node(pod, nodes.get(pod.node), now_ns)
            for watch in self._pods
            for pod in watch.values().values()
            if pod.release == release
        ]


def _with_node(pod: PodState, node: NodeState | None, now_ns: int) -> PodState:
    if node is None:
        return replace(pod, node_gone=bool(pod.node))
    return replace(pod, node_silent_seconds=node.silent_seconds(now_ns))


def _paths(path: str, namespaces: Collection[str]) -> list[str]:
    """The paths that list the objects of all namespaces, or of each of the given ones."""
    group, _, plural = path.rpartition("/")
    return [f"{group}/namespaces/{name}/{plural}" for name in sorted(namespaces)] or [path]


def task_event(task: Object, reason: str, text: str, at: datetime) -> dict[str, Any]:
    """The Event (events.k8s.io/v1) that puts a warning on a task."""
    metadata = task["metadata"]
    regarding = {
        "apiVersion": f"{GROUP}/{VERSION}",
        "kind": "TaskDescription",
        "namespace": metadata["namespace"],
        "name": metadata["name"],
        "uid": metadata.get("uid", ""),
    }
    return _event(regarding, "Deciding", reason, text, at)


def _event(regarding: dict[str, str], action: str, reason: str, text: str, at: datetime) -> dict[str, Any]:
    digest = hashlib.sha256("\0".join([regarding["uid"], reason, text]).encode()).hexdigest()
    return {
        "apiVersion": "events.k8s.io/v1",
        "kind": "Event",
        "metadata": {"namespace": regarding["namespace"], "name": f"{regarding['name'][:200]}.{digest[:16]}"},
        "eventTime": at.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
        "reportingController": f"{GROUP}/manager",
        "reportingInstance": "manager",
        "action": action,
        "reason": reason,
        "regarding": regarding,
        "note": text.encode()[:EVENT_NOTE_BYTES_MAX].decode(errors="ignore"),
        "type": "Warning",
    }


def _demand(task: Object | None) -> Any:
    """The part of a task that is a demand: its status is not."""
    if task is None:
        return None
    metadata = task["metadata"]
    return metadata.get("uid"), metadata.get("generation"), metadata.get("deletionTimestamp")


def read_nodes(item: Object) -> tuple[NodeState, ...]:
    """A Node as each of its agents has it, the host first: of what it has for pods an equal part is each one's, so that
    nothing is planned twice."""
    agents = node_agents(item["metadata"].get("labels", {}))
    return tuple(_node_of(agent, item, len(agents)) for agent in agents)


def read_node(item: Object) -> NodeState:
    """A Node as its host has it."""
    return read_nodes(item)[0]


def _node_of(agent: NodeAgent, item: Object, parts: int) -> NodeState:
    """The Node as one of `parts` agents has it; condition Ready `Unknown` means that its kubelet does not report."""
    metadata = item["metadata"]
    status = item.get("status", {})
    ready: Object = next((c for c in status.get("conditions", []) if c["type"] == "Ready"), {})
    since = read_time_ns(ready.get("lastTransitionTime"))
    return NodeState(
        name=metadata["name"],
        agent=agent.name,
        role=agent.role,
        capabilities=agent.capabilities,
        ready=ready.get("status") == "True",
        cordoned=bool(item.get("spec", {}).get("unschedulable")),
        hold=node_hold(agent.name, metadata),
        allocatable=_allocatable(status.get("allocatable", {}), parts),
        platform=_platform(metadata.get("labels", {})),
        ready_since=since if ready.get("status") == "True" else None,
        not_ready_since=since if ready.get("status") != "True" else None,
        silent_since=since if ready.get("status") == "Unknown" else None,
        created=read_time_ns(metadata.get("creationTimestamp")) or 0,
        guest=agent.guest,
    )


def _allocatable(given: Object, parts: int) -> Resources | None:
    """One of `parts` equal parts of the resources that the node has for pods; None when the kubelet has not reported
    them yet."""
    return read_resources(given).part(parts) if "cpu" in given and "memory" in given else None


def _platform(labels: Object) -> str:
    system = labels.get("kubernetes.io/os", "")
    machine = labels.get("kubernetes.io/arch", "")
    return f"{system}/{machine}" if system and machine else ""


def read_application(item: Object) -> ApplicationState:
    """The fields of an Argo CD Application that decide."""
    metadata = item["metadata"]
    status = item.get("status", {})
    operation = status.get("operationState", {})
    conditions = [f"{c.get('type')}: {c.get('message', '')}" for c in status.get("conditions", [])]
    if operation.get("phase") in ("Failed", "Error"):
        conditions.append(f"operation: {operation.get('message', '')}")
    return ApplicationState(
        name=metadata["name"],
        plan=metadata.get("annotations", {}).get(PLAN_ANNOTATION, ""),
        source=item.get("spec", {}).get("source", {}),
        compared_source=status.get("sync", {}).get("comparedTo", {}).get("source", {}),
        synced_source=operation.get("syncResult", {}).get("source", {}),
        phase=operation.get("phase", ""),
        sync=status.get("sync", {}).get("status", ""),
        health=status.get("health", {}).get("status", ""),
        conditions=tuple(text[:CONDITION_CHARACTERS_MAX] for text in conditions[:CONDITIONS_MAX]),
        deleting=bool(metadata.get("deletionTimestamp")),
        health_since=read_time_ns(status.get("health", {}).get("lastTransitionTime")),
        applied_ns=read_time_ns(operation.get("finishedAt")),
    )
