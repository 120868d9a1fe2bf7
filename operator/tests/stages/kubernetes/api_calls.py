"""What the tests with an API server share: waiting, the administrator's calls, the definitions they need."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from kubernetes import client

from robotkube.delivery.tasks.adapters.kubernetes_tasks import task_path
from robotkube.delivery.tasks.core.task_description import GROUP, PLURAL, VERSION
from robotkube.errors import UnavailableError
from robotkube.foundation.kubernetes.adapters.client import call
from tests.stages.kubernetes import argocd_definitions
from tests.stages.paths import REPOSITORY
from tests.stages.waiting import until

DEFINITION = REPOSITORY / "charts/robotkube/templates/taskdescriptions/customresourcedefinition.yaml"
TASKS = "/apis/robotkube.io/v1alpha1/namespaces/cloud-0/taskdescriptions"
LEASES = "/apis/coordination.k8s.io/v1/namespaces/argocd/leases"
LEASE_LABELS = {"app.kubernetes.io/managed-by": "Helm"}
ARGOCD = "/apis/argoproj.io/v1alpha1/namespaces/argocd/applications"


class Api:
    """The administrator's few calls."""

    def __init__(self, api: client.ApiClient, kubeconfig: Path = Path()) -> None:
        self.client, self.kubeconfig = api, kubeconfig
        self._leases = 0

    def post(self, path: str, body: Mapping[str, Any]) -> None:
        call(self.client, "POST", path, body=body).close()

    def post_text(self, path: str, text: str) -> None:
        """Create an object from JSON that Python could not write."""
        token = self.client.configuration.auth_settings()["BearerToken"]
        headers = {"Content-Type": "application/json", token["key"]: token["value"]}
        url = f"{self.client.configuration.host}{path}"
        answer = self.client.rest_client.pool_manager.request("POST", url, body=text, headers=headers)
        assert answer.status == 201, answer.data[:300]

    def merge(self, path: str, body: Mapping[str, Any]) -> None:
        call(self.client, "PATCH", path, body=body, content_type="application/merge-patch+json").close()

    def delete(self, path: str) -> None:
        call(self.client, "DELETE", path, [("gracePeriodSeconds", "0")]).close()

    def get(self, path: str) -> dict[str, Any]:
        """An object, or a list."""
        document: dict[str, Any] = json.loads(call(self.client, "GET", path).data)
        return document

    def node(self, name: str, role: str) -> None:
        """A ready node of the agent of that name."""
        labels = {
            "robotkube.io/agent": name,
            "robotkube.io/role": role,
            "robotkube.io/capability.recording": "true",
        }
        self.post("/api/v1/nodes", {"apiVersion": "v1", "kind": "Node", "metadata": {"name": name, "labels": labels}})
        ready = {"type": "Ready", "status": "True", "lastTransitionTime": "2026-11-21T10:00:00Z"}
        self.merge(f"/api/v1/nodes/{name}/status", {"status": {"conditions": [ready]}})

    def lease(self) -> str:
        """A new Lease, as charts/robotkube makes it, in namespace argocd; its name."""
        self._leases += 1
        name = f"robotkube-manager-{self._leases}"
        metadata = {"name": name, "labels": dict(LEASE_LABELS)}
        self.post(LEASES, {"apiVersion": "coordination.k8s.io/v1", "kind": "Lease", "metadata": metadata})
        return name

    def task(self, name: str, **spec: Any) -> None:
        """Create a task in cloud-0."""
        event = {"rule": "near", "id": "e1", "time": "2026-11-21T10:00:00Z", "trace": "0" * 32}
        full = {"requester": "somebody", "event": event, "application": "recording", "parameters": {"deep": {"x": 1}}}
        metadata = {"name": name, "namespace": "cloud-0"}
        document = {"apiVersion": "robotkube.io/v1alpha1", "kind": "TaskDescription", "metadata": metadata}
        wanted = {key: value for key, value in {**full, **spec}.items() if value is not None}
        self.post(TASKS, {**document, "spec": wanted})

    def withdraw_tasks(self) -> None:
        """Delete the tasks of all namespaces."""
        for task in self.get(f"/apis/{GROUP}/{VERSION}/{PLURAL}")["items"]:
            self.delete(task_path(task["metadata"]["namespace"], task["metadata"]["name"]))


def prepare(api: Api) -> None:
    """Definitions and namespaces; waits until the definitions are served."""
    text = "".join(line for line in DEFINITION.read_text().splitlines(True) if "{{" not in line)
    for definition in (yaml.safe_load(text), argocd_definitions.short("applications")):
        api.post("/apis/apiextensions.k8s.io/v1/customresourcedefinitions", definition)
    for name in ("cloud-0", "argocd", "robotkube"):
        api.post("/api/v1/namespaces", {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
    for path in (TASKS, ARGOCD):
        until(lambda path=path: served(api, path), f"{path} served")


def served(api: Api, path: str) -> bool:
    try:
        call(api.client, "GET", path).close()
    except (KeyError, UnavailableError):
        return False
    return True
