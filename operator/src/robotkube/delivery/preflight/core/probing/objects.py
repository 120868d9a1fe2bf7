"""The objects of the probe: a namespace of its own with Pod Security restricted, an account without a token, a policy
that lets one port in, and on each Node a pod that serves and one that asks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.preflight.core.probing.answers import OPEN_PORT, VARIABLE, ProbeQuestions
from robotkube.delivery.preflight.core.renderings import Object
from robotkube.foundation.kubernetes.core.access_rights import ApiRight

COMPONENT, RUN = "app.kubernetes.io/component", "robotkube.io/probe-run"
LABELS = {
    "app.kubernetes.io/part-of": "robotkube",
    "app.kubernetes.io/managed-by": "robotkube-preflight",
    COMPONENT: "probe",
}
ACCOUNT = "probe"
SERVE, ASK = "serve", "ask"
COMMAND = "robotkube-probe"
POD_SECONDS_MAX = 60
"""A pod of a probe that was killed ends by itself after that."""
SECURITY = {
    "allowPrivilegeEscalation": False,
    "readOnlyRootFilesystem": True,
    "capabilities": {"drop": ["ALL"]},
}


@dataclass(frozen=True)
class ProbeTarget:
    """What the probe is about: its `namespace`, the `image` that is pulled, the `broker` (host and port; empty and 0
    for none to reach), and names that must resolve."""

    namespace: str
    image: str
    names: Sequence[str]
    broker: tuple[str, int]


def namespace_of(platform: str) -> str:
    """The probe's namespace; the broker's NetworkPolicy lets its pods in."""
    return f"{platform}-probe"


def rights_in(namespace: str) -> Sequence[ApiRight]:
    """All that the probe does at the API server."""
    whole = [ApiRight(verb, "", "namespaces") for verb in ("create", "get", "delete")]
    inside = [
        *(ApiRight(verb, "", "pods", namespace) for verb in ("create", "list", "deletecollection")),
        ApiRight("create", "", "serviceaccounts", namespace),
        ApiRight("create", "networking.k8s.io", "networkpolicies", namespace),
        ApiRight("list", "", "events", namespace),
    ]
    return [*whole, *inside]


def namespace(name: str, run: str) -> Object:
    """The namespace of one run, which alone removes it again."""
    level = {f"pod-security.kubernetes.io/{mode}": "restricted" for mode in ("enforce", "audit", "warn")}
    return {
        "apiVersion": "v1",
        "kind": "Namespace",
        "metadata": {"name": name, "labels": {**LABELS, RUN: run, **level}},
    }


def account() -> Object:
    """The account of the pods, which has no right and no token."""
    metadata = {"name": ACCOUNT, "labels": LABELS}
    return {"apiVersion": "v1", "kind": "ServiceAccount", "metadata": metadata, "automountServiceAccountToken": False}


def policy() -> Object:
    """Whoever enforces NetworkPolicies lets the open port in, and no other one."""
    ingress = [{"ports": [{"protocol": "TCP", "port": OPEN_PORT}]}]
    return {
        "apiVersion": "networking.k8s.io/v1",
        "kind": "NetworkPolicy",
        "metadata": {"name": "one-port", "labels": LABELS},
        "spec": {"podSelector": {}, "policyTypes": ["Ingress"], "ingress": ingress},
    }


def pod(name: str, node: str, image: str, doing: str, questions: ProbeQuestions | None = None) -> Object:
    """A pod on a Node, whatever the Node's taints and the scheduler say."""
    environment = [{"name": VARIABLE, "value": questions.text}] if questions else []
    container: dict[str, Any] = {
        "name": "probe",
        "image": image,
        "imagePullPolicy": "IfNotPresent",
        "command": [COMMAND, doing],
        "env": environment,
        "resources": {"requests": {"cpu": "10m", "memory": "32Mi"}, "limits": {"memory": "128Mi"}},
        "securityContext": SECURITY,
        "volumeMounts": [{"name": "tmp", "mountPath": "/tmp"}],  # noqa: S108 - in the pod
    }
    return {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {"name": name, "labels": LABELS},
        "spec": {
            "nodeName": node,
            "restartPolicy": "Never",
            "activeDeadlineSeconds": POD_SECONDS_MAX,
            "terminationGracePeriodSeconds": 1,
            "serviceAccountName": ACCOUNT,
            "automountServiceAccountToken": False,
            "enableServiceLinks": False,
            "tolerations": [{"operator": "Exists"}],
            "securityContext": {
                "runAsNonRoot": True,
                "runAsUser": 10001,
                "runAsGroup": 10001,
                "seccompProfile": {"type": "RuntimeDefault"},
            },
            "containers": [container],
            "volumes": [{"name": "tmp", "emptyDir": {"sizeLimit": "16Mi"}}],
        },
    }
