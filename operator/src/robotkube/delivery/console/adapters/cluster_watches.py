"""The API server as the console reads it: one watch for each kind, written into the model as it changes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from kubernetes import client

from robotkube.delivery.console.adapters.cluster_documents import (
    agent_document,
    pod_document,
    release_document,
)
from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.core.documents import stranger_documents, task_document
from robotkube.delivery.console.core.platform_processes import ADVICE as WITHOUT
from robotkube.delivery.console.core.platform_processes import CARRIES, NAMES, PlatformProcesses, ProcessPod
from robotkube.delivery.console.ports import BridgePod, Detector, ModelWriting
from robotkube.delivery.inspection.core.strangers import PLURAL as INSPECTIONS
from robotkube.delivery.manager.adapters.kubernetes_cluster import read_nodes
from robotkube.delivery.tasks.core.task_description import GROUP, PLURAL, VERSION
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.kubernetes.adapters.client import ResourceWatch, call
from robotkube.foundation.kubernetes.core.node_agents import AGENT

POLL_SECONDS = 1.0
ALWAYS_THERE = ("nodes", "tasks", "pods")  # Argo CD may be away, and nobody may inspect
DETECTOR_NAME, BRIDGE_NAME = "event-detector", "mqtt-bridge"
NAME_LABEL = "app.kubernetes.io/name"
CONFIG_MAP_VARIABLE = "ROBOTKUBE_CONFIGMAP"
SETTINGS_KEY = "config.yaml"
ADVICE = "What is shown is as of then. Look at the API server, and at the rights of the account console."

Object = Mapping[str, Any]


class ClusterWatches:
    """The watches. `agents` are those that the platform declares; `woken` is called when something changed that
    managers and detectors know more of."""

    def __init__(
        self,
        api: client.ApiClient,
        model: ModelWriting,
        namespaces: tuple[str, str, str],
        agents: Sequence[Object],
        woken: Callable[[], None],
    ) -> None:
        """Watches that have not begun. `namespaces`: the platform's, Argo CD's and the gate's, the last one empty where
        nobody knows it."""
        platform, argocd, gate = namespaces
        self._model = model
        self._agents = {str(agent["name"]): agent for agent in agents}
        self._woken = woken
        tasks = f"/apis/{GROUP}/{VERSION}/{PLURAL}"
        applications = f"/apis/argoproj.io/v1alpha1/namespaces/{argocd}/applications"
        inspections = f"/apis/{GROUP}/{VERSION}/namespaces/{platform}/{INSPECTIONS}"
        self._nodes = ResourceWatch(api, "/api/v1/nodes", AGENT, read_nodes, self._node_changed)
        self._pods = ResourceWatch(api, "/api/v1/pods", AGENT, read_shown_pod, self._pod_changed)
        self._present = PlatformProcesses(platform, argocd, gate)
        labelled = f"{NAME_LABEL} in ({','.join(NAMES)})"
        self._processes = ResourceWatch(api, "/api/v1/pods", labelled, read_process_pod, lambda *_: None)
        self._watches: Mapping[str, tuple[ResourceWatch, Sequence[str]]] = {
            "nodes": (self._nodes, (kinds.AGENTS,)),
            "tasks": (ResourceWatch(api, tasks, "", task_document, self._task_changed), (kinds.TASKS,)),
            "pods": (self._pods, (kinds.PODS,)),
            "applications": (
                ResourceWatch(api, applications, "", release_document, self._application_changed),
                (kinds.RELEASES,),
            ),
            "inspections": (
                ResourceWatch(api, inspections, "", stranger_documents, self._inspection_changed),
                (kinds.STRANGERS,),
            ),
        }

    def run(self, stopping: threading.Event) -> None:
        """Watch, and say of each watch whether it runs, until `stopping` is set."""
        for agent in self._agents.values():
            self._model.put(kinds.AGENTS, str(agent["name"]), agent_document(agent, ()))
        watches = [self._processes, *(watch for watch, _ in self._watches.values())]
        for watch in watches:
            watch.start()
        while not stopping.wait(POLL_SECONDS):
            for name, (watch, carries) in self._watches.items():
                self._model.put_source(f"api-server-{name}", watch.complaint, ADVICE, carries)
            self._say_who_is_there()
        for watch in watches:
            watch.stop()

    def _say_who_is_there(self) -> None:
        """Nothing new is said while the API server is away: its own sources say that."""
        if self._processes.synced.is_set() and not self._processes.complaint:
            for one in self._present.presences(self._processes.values().values()):
                self._model.put_source(one.process, one.problem, WITHOUT[one.process], CARRIES[one.process])

    def missing(self) -> Sequence[str]:
        """What was not read yet of what there always is, a sentence each."""
        watches = (self._watches[name][0] for name in ALWAYS_THERE)
        return [watch.complaint for watch in watches if not watch.synced.is_set()]

    def detectors(self) -> Sequence[Detector]:
        """The event detectors that run now."""
        pods = self._pods.values().values()
        return [detector for pod in pods if (detector := pod["detector"]) is not None and detector.host]

    def bridges(self) -> Sequence[BridgePod]:
        """The bridges that are there now."""
        return [pod["bridge"] for pod in self._pods.values().values() if pod["bridge"] is not None]

    def _node_changed(self, key: str, before: Any, now: Any) -> None:
        nodes = [state for states in self._nodes.values().values() for state in states]
        for name in {node.agent for states in (before, now) if states is not None for node in states}:
            if name in self._agents:
                self._model.put(kinds.AGENTS, name, agent_document(self._agents[name], nodes))

    def _task_changed(self, key: str, before: Any, now: Any) -> None:
        self._model.put_task(key, now)
        self._woken()

    def _pod_changed(self, key: str, before: Any, now: Any) -> None:
        self._model.put(kinds.PODS, key, None if now is None else now["document"])

    def _application_changed(self, key: str, before: Any, now: Any) -> None:
        if before is not None and (now is None or now["release"] != before["release"]):
            self._model.put_release(before["release"], None)
        if now is not None:
            self._model.put_release(now["release"], now)
        self._woken()

    def _inspection_changed(self, key: str, before: Any, now: Any) -> None:
        for gone in set(before or ()) - set(now or ()):
            self._model.put(kinds.STRANGERS, gone, None)
        for name, document in (now or {}).items():
            self._model.put(kinds.STRANGERS, name, document)


def read_process_pod(item: Object) -> ProcessPod:
    """A pod of a process of the platform's."""
    document = pod_document(item)
    ready = document["ready"] and not document["deleting"]
    why = "it is being removed" if document["deleting"] else document["trouble"] or f"it is {document['phase']}"
    return ProcessPod(str(item["metadata"]["labels"][NAME_LABEL]), document["namespace"], ready, why)


def read_shown_pod(item: Object) -> dict[str, Any]:
    """A pod as it is shown, and the event detector or bridge that it is, where it is one."""
    document = pod_document(item)
    name = "" if document["deleting"] else (item["metadata"].get("labels") or {}).get(NAME_LABEL)
    detector = _detector(item, document) if name == DETECTOR_NAME else None
    return {
        "document": document,
        "detector": detector,
        "bridge": _bridge(item, document) if name == BRIDGE_NAME else None,
    }


def _bridge(item: Object, document: Object) -> BridgePod:
    return BridgePod(f"{document['namespace']}/{document['name']}", document["release"], _host(item, document))


def _host(item: Object, document: Object) -> str:
    """The address of a pod's pages, empty while it is not ready."""
    host = str((item.get("status") or {}).get("podIP") or "") if document["ready"] else ""
    return f"[{host}]" if ":" in host else host


def _detector(item: Object, document: Object) -> Detector:
    spec = item.get("spec") or {}
    environment = (variable for one in spec.get("containers") or () for variable in one.get("env") or ())
    settings = next((str(v.get("value") or "") for v in environment if v["name"] == CONFIG_MAP_VARIABLE), "")
    name = f"{document['namespace']}/{document['name']}"
    return Detector(name, document["release"], _host(item, document), settings.rpartition("/")[2])


class ConfigMapSettings:
    """The port Settings: documents in ConfigMaps, each read when it is asked for."""

    def __init__(self, api: client.ApiClient) -> None:
        self._api = api

    def read(self, namespace: str, name: str) -> Mapping[str, Any]:
        """See the port."""
        try:
            answer = call(self._api, "GET", f"/api/v1/namespaces/{namespace}/configmaps/{name}")
        except KeyError:
            return {}
        data = read_json_shortened(answer.data).get("data") or {}
        return read_mapping(data.get(SETTINGS_KEY) or "{}", f"configmap {namespace}/{name}")
