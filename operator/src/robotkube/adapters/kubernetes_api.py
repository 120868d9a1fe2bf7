"""What the manager sees of Kubernetes, kept up to date by one watch per kind; and the statuses of tasks it writes.

A watch lists, then follows the changes from there; a watch that ends in order is taken up where it ended, anything else
(lost connection, expired position) by listing again after a pause. Until the first list of every kind is complete
nothing may be decided: see `wait_until_synced`.
"""

from __future__ import annotations

import hashlib
import json
import logging
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import urllib3
from kubernetes import client, config
from kubernetes.watch.watch import iter_resp_lines

from robotkube.domain.capacities import Resources, read_resources
from robotkube.domain.errors import InputError, UnavailableError
from robotkube.domain.holds import node_hold
from robotkube.domain.json_texts import read_json
from robotkube.domain.observation import ApplicationState, PodState
from robotkube.domain.placement import NodeState
from robotkube.domain.tasks import GROUP, PLURAL, VERSION, object_key
from robotkube.ports.writing import writes

REQUEST_SECONDS_MAX = 10.0
WATCH_SECONDS = 240
SILENCE_SECONDS_MAX = WATCH_SECONDS + 20
BACKOFF_SECONDS_MIN, BACKOFF_SECONDS_MAX = 0.25, 10.0
PAGE_OBJECTS = 500
PAGES_MAX = 200
EVENT_NOTE_BYTES_MAX = 1024
EVENTS_PATH = "/apis/events.k8s.io/v1/namespaces/{namespace}/events"
CONDITIONS_MAX = 5
CONFLICT = 409
CONDITION_CHARACTERS_MAX = 500
TASKS_PATH, PODS_PATH = f"/apis/{GROUP}/{VERSION}/{PLURAL}", "/api/v1/pods"
AGENT_LABEL, ROLE_LABEL = f"{GROUP}/agent", f"{GROUP}/role"
CAPABILITY_PREFIX = f"{GROUP}/capability."
PLAN_ANNOTATION = f"{GROUP}/plan"
RELEASE_LABEL = "app.kubernetes.io/instance"

log = logging.getLogger(__name__)

Object = Mapping[str, Any]


def api_client(kubeconfig: str | None = None, context: str | None = None, in_cluster: bool = False) -> client.ApiClient:
    """A client of the API server: the pod's own account, or a kubeconfig (default: KUBECONFIG or ~/.kube/config)."""
    configuration = client.Configuration()
    try:
        if in_cluster:
            config.load_incluster_config(client_configuration=configuration)
        else:
            config.load_kube_config(config_file=kubeconfig, context=context, client_configuration=configuration)
    except config.ConfigException as error:
        raise InputError(f"no access to a cluster: {error}; name a kubeconfig by --kubeconfig or KUBECONFIG") from error
    configuration.retries = False
    return client.ApiClient(configuration)


def call(
    api: client.ApiClient,
    method: str,
    path: str,
    query: Sequence[tuple[str, str]] = (),
    body: Object | None = None,
    content_type: str = "application/json",
    seconds: float = REQUEST_SECONDS_MAX,
) -> Any:
    """The open answer of one request. UnavailableError when nobody answers or the fault passes, InputError when it is
    refused, KeyError when there is no such object."""
    headers = {"Accept": "application/json", "Content-Type": content_type}
    try:
        return api.call_api(
            path,
            method,
            query_params=list(query),
            header_params=headers,
            body=body,
            auth_settings=["BearerToken"],
            _preload_content=False,
            _request_timeout=(REQUEST_SECONDS_MAX, seconds),
        )
    except client.ApiException as error:
        raise _translated(error, f"{method} {path}") from error
    except (urllib3.exceptions.HTTPError, OSError) as error:
        raise UnavailableError(f"API server: {method} {path}: {error}") from error


def send(api: client.ApiClient, method: str, path: str, body: Object, content_type: str = "application/json") -> None:
    """A request whose answer says nothing more. It is read to its end, which keeps the connection for the next one: a
    new one would cost more than the request."""
    call(api, method, path, body=body, content_type=content_type).read()


def _translated(error: client.ApiException, what: str) -> Exception:
    if error.status == 404:
        return KeyError(what)
    text = f"API server: {what}: {error.status} {_message(error)}"
    passing = error.status in (0, 409, 410, 429) or error.status >= 500
    return UnavailableError(text) if passing else InputError(text)


def _message(error: client.ApiException) -> str:
    try:
        return str(json.loads(error.body)["message"])
    except (ValueError, KeyError, TypeError):
        return str(error.reason)


class ResourceWatch:
    """All objects of one kind, reduced by `reduce`, by `<namespace>/<name>`.

    `changed` is called with key, value before and value now (None: not there) from the watch's thread, only when the
    reduced value differs.
    """

    def __init__(
        self,
        api: client.ApiClient,
        path: str,
        selector: str,
        reduce: Callable[[Object], Any],
        changed: Callable[[str, Any, Any], None],
    ) -> None:
        self._api, self._path, self._selector = api, path, selector
        self._reduce, self._changed = reduce, changed
        self._values: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self.synced = threading.Event()
        self.complaint = f"{path} was not listed yet"

    def values(self) -> dict[str, Any]:
        """A snapshot."""
        with self._lock:
            return dict(self._values)

    def start(self) -> None:
        """Begin on a thread of its own."""
        threading.Thread(target=self._run, name=f"watch {self._path}", daemon=True).start()

    def stop(self) -> None:
        """End within the silence of a watch; the thread does not hold the process."""
        self._stopping.set()

    def _run(self) -> None:
        backoff, version = BACKOFF_SECONDS_MIN, ""
        while not self._stopping.is_set():
            try:
                version = self._follow(version or self._list())
                self.complaint, backoff = "", BACKOFF_SECONDS_MIN
            except (UnavailableError, InputError, KeyError, ValueError) as error:
                self.complaint = f"{self._path}: {error}"
                log.warning("watch interrupted path=%s reason=%s", self._path, error)
                version = ""
                self._stopping.wait(backoff)
                backoff = min(2 * backoff, BACKOFF_SECONDS_MAX)

    def _list(self) -> str:
        """Replace all values; the position from which changes follow."""
        found: dict[str, Any] = {}
        query, version = [("limit", str(PAGE_OBJECTS)), ("labelSelector", self._selector)], ""
        token = ""
        for _ in range(PAGES_MAX):
            answer = read_json(call(self._api, "GET", self._path, [*query, ("continue", token)]).data)
            found |= {object_key(item): self._reduce(item) for item in answer.get("items", [])}
            version, token = answer["metadata"]["resourceVersion"], answer["metadata"].get("continue", "")
            if not token:
                break
        else:
            raise InputError(f"more than {PAGES_MAX * PAGE_OBJECTS} objects; remove old ones")
        before = self.values()
        for key in sorted({*before, *found}):
            self._set(key, found.get(key))
        self.complaint = ""
        self.synced.set()
        return str(version)

    def _follow(self, version: str) -> str:
        """Changes until the server ends the watch; the position reached."""
        query = [
            ("watch", "true"),
            ("allowWatchBookmarks", "true"),
            ("resourceVersion", version),
            ("timeoutSeconds", str(WATCH_SECONDS)),
            ("labelSelector", self._selector),
        ]
        answer = call(self._api, "GET", self._path, query, seconds=SILENCE_SECONDS_MAX)
        try:
            for event in self._events(answer):
                item = event["object"]
                if event["type"] == "ERROR":
                    raise UnavailableError(f"watch refused: {item.get('message', item)}")
                version = str(item["metadata"]["resourceVersion"])
                if event["type"] != "BOOKMARK":
                    self._set(object_key(item), None if event["type"] == "DELETED" else self._reduce(item))
        finally:
            answer.close()
            answer.release_conn()
        return version

    def _events(self, answer: Any) -> Iterator[dict[str, Any]]:
        try:
            for line in iter_resp_lines(answer):
                if self._stopping.is_set():
                    return
                yield read_json(line)
        except (urllib3.exceptions.HTTPError, OSError) as error:
            raise UnavailableError(f"watch ended: {error}") from error

    def _set(self, key: str, value: Any) -> None:
        with self._lock:
            before = self._values.get(key)
            if value is None:
                self._values.pop(key, None)
            else:
                self._values[key] = value
        if before != value:
            self._changed(key, before, value)


class KubernetesWorld:
    """The ports TaskStore and Cluster. `wake` gets `tasks`, `nodes` or `applications` when something that
    matters changed; `now` is the wall clock in seconds. Tasks and pods are seen in `namespaces` (none: in all); `home`
    is the platform's namespace, where Events about Nodes stand."""

    def __init__(
        self,
        api: client.ApiClient,
        argocd_namespace: str,
        wake: Callable[[str], None],
        now: Callable[[], float],
        namespaces: Collection[str] = (),
        home: str = "default",
    ) -> None:
        self._api, self._wake, self._now, self._home = api, wake, now, home
        applications = f"/apis/argoproj.io/v1alpha1/namespaces/{argocd_namespace}/applications"
        self._tasks = [
            ResourceWatch(api, path, "", dict, self._task_changed) for path in _paths(TASKS_PATH, namespaces)
        ]
        self._nodes = ResourceWatch(api, "/api/v1/nodes", AGENT_LABEL, read_node, self._node_changed)
        self._applications = ResourceWatch(api, applications, "", read_application, self._application_changed)
        self._pods = [
            ResourceWatch(api, path, AGENT_LABEL, read_pod, self._application_changed)
            for path in _paths(PODS_PATH, namespaces)
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
        """Whether every kind was listed within the time."""
        each = seconds / len(self._watches)
        return all(watch.synced.wait(each) for watch in self._watches)

    def complaints(self) -> list[str]:
        """One sentence per watch that does not run."""
        return [watch.complaint for watch in self._watches if watch.complaint]

    def _task_changed(self, key: str, before: Object | None, now: Object | None) -> None:
        if _demand(before) != _demand(now):
            self._wake("tasks")

    def _node_changed(self, key: str, before: Any, now: Any) -> None:
        self._wake("nodes")

    def _application_changed(self, key: str, before: Any, now: Any) -> None:
        self._wake("applications")

    def tasks(self) -> Sequence[Object]:
        """All TaskDescriptions of the namespaces."""
        found = {key: task for watch in self._tasks for key, task in watch.values().items()}
        return [found[key] for key in sorted(found)]

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
    def tell(self, task: Object, reason: str, text: str) -> None:
        """A warning on the task. Its name is made from task, reason and text: saying it again is a conflict, and the
        Event that is there says it already."""
        self._say(task_event(task, reason, text, datetime.fromtimestamp(self._now(), UTC)))

    @writes("event")
    def tell_node(self, node: str, reason: str, text: str) -> None:
        """A warning about a Node, in the platform's namespace: a Node has none, and may not be written. Saying the same
        again is a conflict, as with tasks; it does not matter which manager says it."""
        regarding = {"apiVersion": "v1", "kind": "Node", "namespace": self._home, "name": node, "uid": node}
        self._say(_event(regarding, "Watching", reason, text, datetime.fromtimestamp(self._now(), UTC)))

    def _say(self, event: dict[str, Any]) -> None:
        path = EVENTS_PATH.format(namespace=event["metadata"]["namespace"])
        try:
            send(self._api, "POST", path, event)
        except UnavailableError as error:
            if not (isinstance(error.__cause__, client.ApiException) and error.__cause__.status == CONFLICT):
                raise

    def nodes(self) -> Sequence[NodeState]:
        """Nodes of agents."""
        return list(self._nodes.values().values())

    def applications(self) -> Mapping[str, ApplicationState]:
        """Argo CD Applications by name."""
        return {state.name: state for state in self._applications.values().values()}

    def pods(self, release: str) -> Sequence[PodState]:
        """Pods of a release."""
        nodes, now_ns = {node.name: node for node in self._nodes.values().values()}, int(self._now() * 1e9)
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
    """Where the objects of all namespaces, or of each of the given ones, are listed."""
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
    said = hashlib.sha256("\0".join([regarding["uid"], reason, text]).encode()).hexdigest()
    return {
        "apiVersion": "events.k8s.io/v1",
        "kind": "Event",
        "metadata": {"namespace": regarding["namespace"], "name": f"{regarding['name'][:200]}.{said[:16]}"},
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
    """What of a task is a demand: statuses are not."""
    if task is None:
        return None
    metadata = task["metadata"]
    return metadata.get("uid"), metadata.get("generation"), metadata.get("deletionTimestamp")


def read_node(item: Object) -> NodeState:
    """The Node; condition Ready `Unknown` means that nothing is heard of its kubelet."""
    metadata, status = item["metadata"], item.get("status", {})
    labels = metadata.get("labels", {})
    ready: Object = next((c for c in status.get("conditions", []) if c["type"] == "Ready"), {})
    since = _time_ns(ready.get("lastTransitionTime"))
    return NodeState(
        name=metadata["name"],
        agent=labels.get(AGENT_LABEL, ""),
        role=labels.get(ROLE_LABEL, ""),
        capabilities=frozenset(
            key.removeprefix(CAPABILITY_PREFIX)
            for key, value in labels.items()
            if key.startswith(CAPABILITY_PREFIX) and value == "true"
        ),
        ready=ready.get("status") == "True",
        cordoned=bool(item.get("spec", {}).get("unschedulable")),
        hold=node_hold(labels.get(AGENT_LABEL, ""), metadata),
        allocatable=_allocatable(status.get("allocatable", {})),
        platform=_platform(labels),
        ready_since=since if ready.get("status") == "True" else None,
        not_ready_since=since if ready.get("status") != "True" else None,
        silent_since=since if ready.get("status") == "Unknown" else None,
        created=_time_ns(metadata.get("creationTimestamp")) or 0,
    )


def _allocatable(given: Object) -> Resources | None:
    """What the node has for pods; None when the kubelet has not said it yet."""
    return read_resources(given) if "cpu" in given and "memory" in given else None


def _platform(labels: Object) -> str:
    system, machine = labels.get("kubernetes.io/os", ""), labels.get("kubernetes.io/arch", "")
    return f"{system}/{machine}" if system and machine else ""


def read_time(text: str) -> float:
    """Kubernetes' time text as seconds since 1970."""
    return datetime.fromisoformat(text.replace("Z", "+00:00")).astimezone(UTC).timestamp()


def _time_ns(text: str | None) -> int | None:
    return None if text is None else int(read_time(text)) * 1_000_000_000


def read_application(item: Object) -> ApplicationState:
    """The fields of an Argo CD Application that decide."""
    metadata, status = item["metadata"], item.get("status", {})
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
        health_since=_time_ns(status.get("health", {}).get("lastTransitionTime")),
    )


def read_pod(item: Object) -> PodState:
    """The fields of a pod that decide."""
    metadata = item["metadata"]
    release = metadata.get("labels", {}).get(RELEASE_LABEL, "")
    images = (c.get("imageID", "").rpartition("@")[2] for c in item.get("status", {}).get("containerStatuses", []))
    return PodState(
        namespace=metadata["namespace"],
        name=metadata["name"],
        release=f"{metadata['namespace']}/{release}",
        node=item.get("spec", {}).get("nodeName", ""),
        deleting=bool(metadata.get("deletionTimestamp")),
        images=tuple(sorted({image for image in images if image})),
    )
