"""Workloads as a real API server returns them, compared with what was applied: it fills in nothing that looks strange,
and what somebody added while no policy looked is named."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from robotkube.delivery.inspection.adapters.kubernetes_workloads import PATHS, KubernetesWorkloads
from robotkube.delivery.inspection.core.comparison import differences
from robotkube.delivery.inspection.core.permitted import Permitted, ReleaseShape
from robotkube.delivery.inspection.core.pod_templates import pod_differences
from robotkube.delivery.inspection.core.strangers import Stranger
from robotkube.delivery.inspection.core.workload_checks import strangers_among
from robotkube.delivery.inspection.loops.looks import ReleaseLooks
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from robotkube.registry.admission.core.allowed import Allowed
from tests.stages.attacks import shown
from tests.stages.delivery.inspection.inspected_node import CHART, DOMAIN, RENDERED, VERIFIED
from tests.stages.kubernetes.judged_api_server import MERGE, Api, judged_api_server
from tests.stages.paths import REPOSITORY
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain]  # a server of its own
GOLDEN = REPOSITORY / "operator" / "tests" / "charts" / "golden"
APPS = ("bag-player", "event-detector", "mqtt-bridge", "object-detection", "object-tracking")
APPLY = "application/apply-patch+yaml"
JSON_PATCH = "application/json-patch+json"
PLACE = "/apis/apps/v1/namespaces/vehicle-00/deployments"
HTTP = {"httpGet": {"port": 8081}}

POD: dict[str, Any] = {
    "serviceAccountName": "application",
    "initContainers": [{"name": "first", "image": f"x.example/y@{VERIFIED}", "command": ["true"]}],
    "containers": [
        {
            "name": "detector",
            "image": f"forge.example/robotkube/ros@{VERIFIED}",
            "ports": [{"containerPort": 8081}],
            "env": [
                {"name": "EMPTY", "value": ""},
                {"name": "NODE", "valueFrom": {"fieldRef": {"fieldPath": "spec.nodeName"}}},
                {"name": "CPU", "valueFrom": {"resourceFieldRef": {"resource": "limits.cpu"}}},
                {"name": "KEY", "valueFrom": {"secretKeyRef": {"name": "a", "key": "b"}}},
            ],
            "envFrom": [{"configMapRef": {"name": "a"}}],
            "livenessProbe": HTTP,
            "readinessProbe": {"tcpSocket": {"port": 8081}},
            "startupProbe": {"grpc": {"port": 8081}},
            "lifecycle": {"preStop": {"httpGet": {"port": 8081, "path": "/"}}},
            "resources": {"requests": {"cpu": "1000m", "memory": "0.5Gi"}, "limits": {"cpu": 2, "memory": "1024Mi"}},
            "securityContext": {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}},
            "volumeMounts": [{"name": "settings", "mountPath": "/etc/x", "readOnly": True}],
        }
    ],
    "volumes": [
        {"name": "settings", "configMap": {"name": "a"}},
        {"name": "secret", "secret": {"secretName": "a"}},
        {"name": "tmp", "emptyDir": {"sizeLimit": "1024Mi"}},
        {"name": "plain", "emptyDir": {}},
        {"name": "claim", "persistentVolumeClaim": {"claimName": "a"}},
        {"name": "down", "downwardAPI": {"items": [{"path": "a", "fieldRef": {"fieldPath": "metadata.name"}}]}},
        {
            "name": "token",
            "projected": {
                "sources": [
                    {"serviceAccountToken": {"path": "token"}},
                    {"configMap": {"name": "a", "items": [{"key": "a", "path": "b"}]}},
                    {"downwardAPI": {"items": [{"path": "a", "fieldRef": {"fieldPath": "metadata.name"}}]}},
                ]
            },
        },
    ],
    "topologySpreadConstraints": [
        {"maxSkew": 1, "topologyKey": "zone", "whenUnsatisfiable": "ScheduleAnyway", "labelSelector": {}}
    ],
}
LEAST: dict[str, Any] = {"containers": [{"name": "a", "image": f"x.example/y@{VERIFIED}"}]}
SILENT = {"apiVersion": "apps/v1", "kind": "Deployment", "metadata": {"name": "silent"}}
"""As little as a manifest may say: everything else is filled in."""


def rendered(pod: dict[str, Any], name: str, **spec: Any) -> dict[str, Any]:
    labels = {"app.kubernetes.io/instance": "detector"}
    template = {"metadata": {"labels": labels}, "spec": pod}
    whole = {"selector": {"matchLabels": labels}, "template": template, **spec}
    return {**SILENT, "metadata": {"name": name, "labels": labels}, "spec": whole}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with judged_api_server(tmp_path_factory.mktemp("api"), None, gives_tokens=True) as (api, _):
        api.done("POST", "/api/v1/namespaces", {"metadata": {"name": "vehicle-00"}})
        yield api


def applied(api: Api, item: dict[str, Any]) -> dict[str, Any]:
    """The object after it was applied as Argo CD does."""
    path = f"{PLACE}/{item['metadata']['name']}"
    api.done("PATCH", f"{path}?fieldManager=argocd-controller&force=true", item, kind=APPLY)
    return api.done("GET", path)


@pytest.mark.parametrize(
    "spec",
    [{}, {"strategy": {"type": "Recreate"}}, {"strategy": {"type": "RollingUpdate"}}, {"replicas": 3}],
    ids=str,
)
def test_what_the_api_server_fills_in_is_explained(api: Api, spec: dict[str, Any]) -> None:
    item = rendered(POD, f"silent-{len(str(spec))}", **spec)
    assert differences(applied(api, item), item) == ()


@pytest.mark.parametrize("chart", APPS)
def test_our_own_charts_are_as_they_are_rendered(api: Api, chart: str) -> None:
    documents = yaml.safe_load_all((GOLDEN / f"{chart}.yaml").read_text(encoding="utf-8"))
    [item] = [document for document in documents if document and document["kind"] == "Deployment"]
    item["metadata"]["name"] = chart
    assert differences(applied(api, item), item) == ()


def test_fields_of_which_nothing_is_said_are_explained(api: Api) -> None:
    item = rendered(LEAST, "least")
    assert differences(applied(api, item), item) == ()


def as_pod(api: Api, item: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A pod of a Deployment's template as the API server has it, made as a ReplicaSet makes it, and that template."""
    template = applied(api, item)["spec"]["template"]
    labels = {**template["metadata"]["labels"], "pod-template-hash": "5d9c7b"}
    metadata = {**template["metadata"], "name": f"{item['metadata']['name']}-5d9c7b-x", "labels": labels}
    account = template["spec"].get("serviceAccountName", "default")
    place = "/api/v1/namespaces/vehicle-00"
    api.request("POST", f"{place}/serviceaccounts", {"metadata": {"name": account}})  # it may be there
    made = api.done("POST", f"{place}/pods", {"metadata": metadata, "spec": template["spec"]})
    return made, item["spec"]["template"]


def of_a_pod(made: dict[str, Any], template: dict[str, Any]) -> tuple[str, ...]:
    metadata = made["metadata"]
    return pod_differences(metadata["labels"], metadata.get("annotations", {}), made["spec"], template)


@pytest.mark.parametrize("chart", APPS)
def test_a_pod_of_our_own_charts_is_its_template(api: Api, chart: str) -> None:
    documents = yaml.safe_load_all((GOLDEN / f"{chart}.yaml").read_text(encoding="utf-8"))
    [item] = [document for document in documents if document and document["kind"] == "Deployment"]
    item["metadata"]["name"] = f"pod-of-{chart}"
    made, template = as_pod(api, item)
    assert of_a_pod(made, template) == ()


@pytest.mark.parametrize(("pod", "name"), [(POD, "silent"), (None, "least")], ids=["much", "least"])
def test_what_is_filled_into_pods_is_explained(api: Api, pod: dict[str, Any] | None, name: str) -> None:
    """The account's token, tolerations and priority among it, and requests where there are limits alone."""
    least = {"containers": [{"name": "a", "image": f"x.example/y@{VERIFIED}", "resources": {"limits": {"cpu": "1"}}}]}
    made, template = as_pod(api, rendered(pod or least, f"pod-{name}"))
    assert of_a_pod(made, template) == ()
    assert made["spec"]["volumes"][-1]["name"].startswith("kube-api-access-")
    assert {"priority", "preemptionPolicy", "tolerations"} <= set(made["spec"])


def patched(api: Api, patch: Any, kind: str) -> Stranger:
    """The stranger that the detector's Deployment is after a patch, as the inspector reads it.

    The inspector lists what the API server holds in memory, which trails its store; so does this, from the patch on.
    """
    done = api.done("PATCH", f"{PLACE}/detector", patch, kind=kind)["metadata"]["resourceVersion"]
    shape = ReleaseShape("detector", CHART, {"detector": json.loads(json.dumps({**RENDERED, "metadata": METADATA}))})
    permitted = Permitted(DOMAIN, Allowed((VERIFIED,), (), (CHART,)), {"vehicle-00": [shape]})
    listed = api.done("GET", f"{PLACE}?resourceVersion={done}&resourceVersionMatch=NotOlderThan")["items"]
    (one,) = [
        stranger
        for item in listed
        if item["metadata"]["name"] == "detector"
        for stranger in strangers_among(item, "Deployment", permitted)
    ]
    return one


METADATA = {"name": "detector", "labels": {"app.kubernetes.io/instance": "detector"}}


def test_what_somebody_adds_to_a_workload_is_named(api: Api) -> None:
    item = copy.deepcopy(dict(RENDERED))
    applied(api, item)
    note = {"metadata": {"annotations": {"example.com/note": "x"}}}
    shown("nodes", patched(api, note, MERGE).message, "annotation", "annotation-by-status")
    api.done("PATCH", f"{PLACE}/detector", {"metadata": {"annotations": None}}, kind=MERGE)
    sidecar = [{"op": "add", "path": "/spec/template/spec/containers/-", "value": {"name": "miner", "image": "x"}}]
    message = patched(api, sidecar, JSON_PATCH).message
    assert "miner added" in message
    shown("nodes", message, "sidecar")


@pytest.fixture
def workloads(api: Api) -> Iterator[KubernetesWorkloads]:
    """The inspector's own adapter."""
    server = api.server
    token = server.folder / "token"
    token.write_text(server.token)
    reached = ApiServer(f"https://127.0.0.1:{server.port}", token, _authority(api))
    yield KubernetesWorkloads(reached)
    reached.close()


def test_every_kind_of_workload_can_be_listed(workloads: KubernetesWorkloads) -> None:
    assert {kind: len(workloads.read("cloud-0", kind)) for kind in workloads.kinds} == dict.fromkeys(workloads.kinds, 0)
    assert workloads.read("cloud-0", "ConfigMap") == []


def test_kinds_that_start_no_pod_are_named_by_one_look(api: Api, workloads: KubernetesWorkloads) -> None:
    """By their metadata alone: their templates are not sent. A Job of a CronJob is not named beside it."""
    template = {"metadata": {"labels": {"a": "b"}}, "spec": {**LEAST, "restartPolicy": "Never"}}
    running = {**template, "spec": {**template["spec"], "restartPolicy": "Always"}}
    selected = {"replicas": 0, "selector": {"matchLabels": {"a": "b"}}, "template": running}
    job = {"suspend": True, "template": template}
    specs = {
        "ReplicaSet": selected,
        "StatefulSet": {**selected, "serviceName": "x"},
        "DaemonSet": {"selector": {"matchLabels": {"a": "b"}}, "template": running},
        "Job": job,
        "CronJob": {"suspend": True, "schedule": "* * * * *", "jobTemplate": {"spec": {"template": template}}},
        "ReplicationController": {"replicas": 0, "selector": {"a": "b"}, "template": running},
    }
    made = {}
    for kind in workloads.kinds:
        body = {"template": running} if kind == "PodTemplate" else {"spec": specs[kind]}
        group, plural = PATHS[kind]
        path = f"{group}/namespaces/vehicle-00/{plural}"
        made[kind] = api.done("POST", path, {"metadata": {"name": "miner"}, **body})
        until(lambda kind=kind: bool(workloads.read("vehicle-00", kind)))  # the list comes from what it holds in memory
        (item,) = workloads.read("vehicle-00", kind)
        assert set(item) <= {"kind", "apiVersion", "metadata"}
    owner = {"apiVersion": "batch/v1", "kind": "CronJob", "name": "miner", "uid": made["CronJob"]["metadata"]["uid"]}
    metadata = {"name": "of-it", "ownerReferences": [{**owner, "controller": True}]}
    api.done("POST", "/apis/batch/v1/namespaces/vehicle-00/jobs", {"metadata": metadata, "spec": job})
    until(lambda: len(workloads.read("vehicle-00", "Job")) == 2)
    permitted = Permitted(DOMAIN, Allowed((VERIFIED,), (), (CHART,)), {})
    strangers = ReleaseLooks(workloads).look(permitted).strangers
    assert {
        (stranger.kind, stranger.name, stranger.reason) for stranger in strangers if stranger.kind != "Deployment"
    } == {(kind, "miner", "NoRelease") for kind in workloads.kinds}


def _authority(api: Api) -> Any:
    return api.server.folder / "certificates" / "apiserver.crt"
