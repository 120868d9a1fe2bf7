"""A pod compared with the template of its workload, every field of it.

A pod is its template and what is written into each pod by something that is known: the API server's admission plugins,
the scheduler, the kubelet, the network. What is none of these was put there by somebody else, as a mutating policy or
webhook, which changes a pod while its Deployment stays as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.delivery.inspection.core.comparison import differences
from robotkube.registry.admission.core.subresources import OF_NETWORKS

Object = Mapping[str, Any]

KINDS = ("containers", "initContainers")
LABELS = ("pod-template-hash", "topology.kubernetes.io/region", "topology.kubernetes.io/zone")
"""Labels of the ReplicaSet controller, and of the node's place (admission plugin PodTopologyLabels)."""
LIMIT_RANGER = "kubernetes.io/limit-ranger"
ANNOTATIONS = ("kubernetes.io/config.", LIMIT_RANGER, *OF_NETWORKS)  # the first is the kubelet's, in its own list
"""How annotations begin that kubelets, admission plugins and networks write on pods: no program runs by them."""
GIVEN = ("nodeName", "priority", "preemptionPolicy", "priorityClassName", "imagePullSecrets")
"""Where it runs, who goes first and who pulls: of the scheduler, of priority classes, of the service account."""
ACCOUNT, FORMER_ACCOUNT, DEFAULT_ACCOUNT = "serviceAccountName", "serviceAccount", "default"
TOLERATIONS = tuple(
    {"key": f"node.kubernetes.io/{key}", "operator": "Exists", "effect": "NoExecute", "tolerationSeconds": 300}
    for key in ("not-ready", "unreachable")
)
"""Of the admission plugin DefaultTolerationSeconds."""
TOKEN_NAME, TOKEN_PATH = "kube-api-access-", "/var/run/secrets/kubernetes.io/serviceaccount"
TOKEN = {
    "defaultMode": 420,
    "sources": [
        {"serviceAccountToken": {"expirationSeconds": 3607, "path": "token"}},
        {"configMap": {"name": "kube-root-ca.crt", "items": [{"key": "ca.crt", "path": "ca.crt"}]}},
        {
            "downwardAPI": {
                "items": [{"path": "namespace", "fieldRef": {"apiVersion": "v1", "fieldPath": "metadata.namespace"}}]
            }
        },
    ],
}
"""The volume of the admission plugin ServiceAccount."""


def pod_differences(labels: Object, annotations: Object, spec: Object, template: Object) -> tuple[str, ...]:
    """What of a pod its workload's template does not explain, and what of the template it has not, a few words each.
    Containers that were added while it ran (ephemeral ones) are not looked at here."""
    metadata: Object = template.get("metadata") or {}
    rendered: Object = template.get("spec") or {}
    limited = LIMIT_RANGER in annotations
    live = {
        "metadata": {"labels": _labels(labels, metadata), "annotations": _annotations(annotations, metadata)},
        "spec": _without_additions(spec, rendered, limited),
    }
    words = {part: metadata[part] for part in ("labels", "annotations") if metadata.get(part)}
    wanted = {"metadata": words, "spec": _as_pods_have_it(rendered)}
    problems = differences({"spec": {"template": live}}, {"spec": {"template": wanted}})
    return tuple(problem.removeprefix("spec.template.") for problem in problems)


def _labels(labels: Object, metadata: Object) -> Object:
    known = metadata.get("labels") or {}
    return {key: value for key, value in labels.items() if key in known or key not in LABELS}


def _annotations(annotations: Object, metadata: Object) -> Object:
    known = metadata.get("annotations") or {}
    return {key: value for key, value in annotations.items() if key in known or not key.startswith(ANNOTATIONS)}


def _without_additions(spec: Object, template: Object, limited: bool) -> dict[str, Any]:
    """The pod's spec without what is written into every pod."""
    live = {key: value for key, value in spec.items() if key in template or key not in GIVEN}
    live.pop("ephemeralContainers", None)
    if ACCOUNT not in template and live.get(ACCOUNT) == DEFAULT_ACCOUNT:
        live.pop(ACCOUNT)
        live.pop(FORMER_ACCOUNT, None)
    if template.get("runtimeClassName"):
        live.pop("overhead", None)  # what its class adds
    tolerations = template.get("tolerations") or ()
    kept = [one for one in live.pop("tolerations", ()) if one in tolerations or one not in TOLERATIONS]
    live |= {"tolerations": kept} if kept else {}
    token = _token(live, template)
    live["volumes"] = [one for one in live.get("volumes") or () if one["name"] != token]
    for kind in KINDS:
        known = {one["name"]: one for one in template.get(kind) or ()}
        entries = live.pop(kind, None) or ()
        live |= {kind: [_container(entry, known.get(entry["name"], {}), token, limited) for entry in entries]}
    return live


def _token(spec: Object, template: Object) -> str:
    """The name of the volume with the account's token that a pod is given, where its template does not forbid it."""
    if template.get("automountServiceAccountToken") is False:
        return ""
    own = {one["name"] for one in template.get("volumes") or ()}
    given = (one["name"] for one in spec.get("volumes") or () if one == {"name": one["name"], "projected": TOKEN})
    return next((name for name in given if name.startswith(TOKEN_NAME) and name not in own), "")


def _container(entry: Object, template: Object, token: str, limited: bool) -> dict[str, Any]:
    live = _without_policy(entry)
    mount = {"name": token, "mountPath": TOKEN_PATH, "readOnly": True}
    live["volumeMounts"] = [one for one in live.get("volumeMounts") or () if one != mount]
    if limited:
        live["resources"] = _as_in(live.get("resources") or {}, template.get("resources") or {})
    return live


def _as_in(resources: Object, template: Object) -> Object:
    """Resources without amounts that the template does not name: those of the namespace's LimitRange."""
    known = {part: {**(template.get("limits") or {}), **(template.get(part) or {})} for part in resources}
    amounts = {part: values for part, values in resources.items() if part in ("limits", "requests")}
    kept = {part: {key: values[key] for key in values if key in known[part]} for part, values in amounts.items()}
    return {**resources, **kept}


def _as_pods_have_it(template: Object) -> Object:
    """The template's spec with what the API server fills into pods, and not into templates: a container that names
    limits alone requests as much."""
    rendered: dict[str, Any] = {**template, "volumes": template.get("volumes") or []}
    for kind in KINDS:
        rendered[kind] = [_requesting(_without_policy(entry)) for entry in _entries(template, kind)]
    return rendered


def _requesting(container: dict[str, Any]) -> dict[str, Any]:
    resources = container.get("resources") or {}
    limits = resources.get("limits") or {}
    requests = {**limits, **(resources.get("requests") or {})}
    filled = {**resources, "requests": requests} if limits else resources
    return {**container, "resources": filled, "volumeMounts": container.get("volumeMounts") or []}


def _without_policy(container: Object) -> dict[str, Any]:
    """Without its pull policy: images are named by digest, and a cluster may set one policy for all."""
    return {key: value for key, value in container.items() if key != "imagePullPolicy"}


def _entries(spec: Object, kind: str) -> Sequence[Object]:
    return spec.get(kind) or ()
