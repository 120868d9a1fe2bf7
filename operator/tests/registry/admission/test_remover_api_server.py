"""What admission lets the remover do to a release's Deployment on a real API server: take away, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.stages.kubernetes.judged_api_server import ADMINISTRATOR, JSON_PATCH, Api
from tests.stages.registry.admission_examples import (
    APPLICATION_CONTROLLER,
    DOMAIN,
    KINDS,
    VERIFIED,
    image,
    path,
    pod,
    workload,
)

pytestmark = [pytest.mark.toolchain]  # a server of the session
REMOVER = DOMAIN.remover_account
NAMESPACE = "vehicle-00"
DRY = "?dryRun=All"
REFUSED = f"deployments detector changed by {REMOVER}: in an agent's namespace nothing runs but what main says"
POD = "/spec/template/spec"
MAIN = f"{POD}/containers/0"
OTHER = image(11)

Step = dict[str, Any]


@pytest.fixture(scope="module")
def api(under_policies: Api) -> Iterator[Api]:
    for name in (NAMESPACE, "robotkube-suite-0", "robotkube"):
        under_policies.request("POST", "/api/v1/namespaces", {"metadata": {"name": name}})
    under_policies.done("POST", path("Deployment", NAMESPACE), changed_deployment(), APPLICATION_CONTROLLER)
    yield under_policies
    under_policies.done("DELETE", f"{path('Deployment', NAMESPACE)}/detector")


def changed_deployment(kind: str = "Deployment") -> Step:
    """A workload with everything that somebody may have added."""
    whole = workload(kind)
    whole["metadata"] |= {"annotations": {"note": "mine", "kept": "1"}, "labels": {"mine": "1"}}
    template = whole["spec"]["template"]
    template["metadata"]["annotations"] = {"note": "mine", "kept": "1"}
    main = template["spec"]["containers"][0]
    main |= {
        "env": [{"name": "A", "value": "1"}, {"name": "B", "value": "2"}],
        "volumeMounts": [{"name": "one", "mountPath": "/one"}, {"name": "two", "mountPath": "/two"}],
        "command": ["sh", "-c"],
        "args": ["true", "false"],
        "ports": [{"containerPort": 80, "protocol": "TCP"}, {"containerPort": 81, "protocol": "TCP"}],
        "lifecycle": {"preStop": {"exec": {"command": ["true"]}}},
        "securityContext": {"runAsNonRoot": True, "runAsUser": 10001},
        "readinessProbe": {"exec": {"command": ["true"]}},
    }
    template["spec"] |= {
        "volumes": [{"name": "one", "emptyDir": {}}, {"name": "two", "emptyDir": {}}],
        "initContainers": [{"name": "first", "image": VERIFIED}, {"name": "second", "image": VERIFIED}],
        "tolerations": [{"key": "a", "operator": "Exists"}, {"key": "b", "operator": "Exists"}],
        "hostAliases": [{"ip": "10.0.0.1", "hostnames": ["x"]}],
        "securityContext": {"runAsNonRoot": True, "runAsUser": 10001},
        "automountServiceAccountToken": False,
    }
    template["spec"]["containers"].append({"name": "side", "image": VERIFIED})
    return whole


def remove(*pointers: str) -> list[Step]:
    return [{"op": "remove", "path": pointer} for pointer in pointers]


def put(pointer: str, value: Any, op: str = "add") -> list[Step]:
    return [{"op": op, "path": pointer, "value": value}]


TAKEN: dict[str, list[Step]] = {
    "sidecar": remove(f"{POD}/containers/1"),
    "the container before": remove(f"{POD}/containers/0"),
    "first init container": remove(f"{POD}/initContainers/0"),
    "all init containers": remove(f"{POD}/initContainers"),
    "volume and its mount": remove(f"{POD}/volumes/1", f"{MAIN}/volumeMounts/1"),
    "variable": remove(f"{MAIN}/env/0"),
    "all variables": remove(f"{MAIN}/env"),
    "port": remove(f"{MAIN}/ports/1"),
    "command and arguments": remove(f"{MAIN}/command", f"{MAIN}/args"),
    "hook": remove(f"{MAIN}/lifecycle"),
    "probe": remove(f"{MAIN}/readinessProbe"),
    "toleration": remove(f"{POD}/tolerations/0"),
    "name of a host": remove(f"{POD}/hostAliases"),
    "annotation": remove("/metadata/annotations/note"),
    "annotation of the pods": remove("/spec/template/metadata/annotations/note"),
    "all annotations": remove("/metadata/annotations", "/spec/template/metadata/annotations"),
    "label": remove("/metadata/labels"),
    "all of it": remove(
        f"{POD}/containers/1",
        f"{POD}/volumes",
        f"{MAIN}/volumeMounts",
        f"{MAIN}/env",
        f"{POD}/initContainers",
        "/metadata/annotations/note",
        "/metadata/labels/mine",
        "/spec/template/metadata/annotations/note",
    ),
}
ADDED: dict[str, list[Step]] = {
    "sidecar": put(f"{POD}/containers/-", {"name": "more", "image": VERIFIED}),
    "sidecar for sidecar": put(f"{POD}/containers/1", {"name": "more", "image": VERIFIED}, "replace"),
    "init container": put(f"{POD}/initContainers/-", {"name": "more", "image": VERIFIED}),
    "container moved to the first ones": remove(f"{POD}/containers/1")
    + put(f"{POD}/initContainers/-", {"name": "side", "image": VERIFIED}),
    "volume": put(f"{POD}/volumes/-", {"name": "more", "emptyDir": {}}),
    "volume of another kind": put(f"{POD}/volumes/1", {"name": "two", "configMap": {"name": "x"}}, "replace"),
    "annotation": put("/metadata/annotations/more", "1"),
    "annotation of the pods": put("/spec/template/metadata/annotations/more", "1"),
    "annotation of another value": put("/metadata/annotations/kept", "2"),
    "label": put("/metadata/labels/more", "1"),
    "label of the pods": put("/spec/template/metadata/labels/more", "1"),
    "verified image for another one": put(f"{MAIN}/image", OTHER),
    "variable": put(f"{MAIN}/env/-", {"name": "C", "value": "3"}),
    "variable of another value": put(f"{MAIN}/env/0/value", "2"),
    "mount": put(f"{MAIN}/volumeMounts/-", {"name": "one", "mountPath": "/more"}),
    "mount elsewhere": put(f"{MAIN}/volumeMounts/0/mountPath", "/more"),
    "command": put(f"{MAIN}/command", ["sh"]),
    "fewer words of the command": remove(f"{MAIN}/command/1"),
    "fewer arguments": remove(f"{MAIN}/args/1"),
    "hook": put(f"{MAIN}/lifecycle/postStart", {"exec": {"command": ["true"]}}),
    "working directory": put(f"{MAIN}/workingDir", "/work"),
    "limits of a container taken away": remove(f"{MAIN}/securityContext"),
    "a limit of a container taken away": remove(f"{MAIN}/securityContext/runAsUser"),
    "limits of the pod taken away": remove(f"{POD}/securityContext"),
    "a token instead of none": remove(f"{POD}/automountServiceAccountToken"),
    "account": put(f"{POD}/serviceAccountName", "event-detector"),
    "node": put(f"{POD}/nodeName", "one"),
    "replicas": put("/spec/replicas", 5),
    "none": put("/spec/replicas", 0),
    "paused": put("/spec/paused", True),
    "strategy": put("/spec/strategy", {"type": "Recreate"}),
    "finalizer of the pods": put("/spec/template/metadata/finalizers", ["example.org/wait"]),
    "something taken away and something added": remove(f"{POD}/containers/1") + put("/metadata/annotations/more", "1"),
}


def address() -> str:
    return f"{path('Deployment', NAMESPACE)}/detector{DRY}"


@pytest.mark.parametrize("what", TAKEN)
def test_it_may_take_away(api: Api, what: str) -> None:
    api.done("PATCH", address(), TAKEN[what], REMOVER, JSON_PATCH)
    assert api.refusal("PATCH", address(), TAKEN[what], ADMINISTRATOR, JSON_PATCH)


@pytest.mark.parametrize("what", ADDED)
def test_it_may_add_and_change_nothing(api: Api, what: str) -> None:
    words = api.refusal("PATCH", address(), ADDED[what], REMOVER, JSON_PATCH)
    assert words.startswith(REFUSED)


def test_whoever_is_named_alike_is_somebody_else(api: Api) -> None:
    for user in (f"{REMOVER}s", "remover", REMOVER.replace("robotkube", "vehicle-00"), "system:serviceaccount::"):
        assert api.refusal("PATCH", address(), TAKEN["sidecar"], user, JSON_PATCH)


def test_it_makes_nothing(api: Api) -> None:
    for kind in ("Deployment", "DaemonSet", "Job"):
        assert api.refusal("POST", path(kind, NAMESPACE), workload(kind, name="new"), REMOVER)
    assert api.refusal("POST", path("Pod", NAMESPACE), pod(name="new"), REMOVER)


@pytest.mark.parametrize("kind", ["StatefulSet", "DaemonSet", "Job"])
def test_of_other_kinds_it_takes_nothing_away(api: Api, kind: str) -> None:
    whole = workload(kind)
    whole["metadata"]["annotations"] = {"note": "mine"}
    api.done("POST", path(kind, NAMESPACE), whole, KINDS[kind][2])
    words = api.refusal(
        "PATCH", f"{path(kind, NAMESPACE)}/detector{DRY}", remove("/metadata/annotations/note"), REMOVER, JSON_PATCH
    )
    assert words.startswith(f"{KINDS[kind][1]} detector changed by {REMOVER}")
    api.done("DELETE", f"{path(kind, NAMESPACE)}/detector?propagationPolicy=Background")


def test_a_pod_is_deleted_and_not_changed(api: Api) -> None:
    """Deletions are not judged, so the rights say who may delete."""
    maker = "system:serviceaccount:kube-system:replicaset-controller"
    api.done("POST", path("Pod", NAMESPACE), {**pod(), "metadata": {"name": "pod", "labels": {"app": "x"}}}, maker)
    place = f"{path('Pod', NAMESPACE)}/pod"
    assert api.refusal("PATCH", place + DRY, remove("/metadata/labels"), REMOVER, JSON_PATCH)
    api.done("DELETE", f"{place}?gracePeriodSeconds=0", None, REMOVER)
