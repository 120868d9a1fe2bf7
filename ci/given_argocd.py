"""What the platform's installation writes into an Argo CD that others installed: kept before, and given back.

The Job bootstrap gives its manager an account, names who signs hooks and certificates, closes the project `default`,
and restarts what reads them. Whatever of this was there before is in a Secret of the platform's namespace meanwhile.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping
from typing import Any

from ci.errors import SetUpError
from robotkube.delivery.preflight.core.argocd import SERVER, ServerSpeech

NAMESPACE, PLATFORM = "argocd", "robotkube"
KEPT = "argocd-before"
KEY = "objects.json"
MAPS = ("argocd-cm", "argocd-rbac-cm", "argocd-tls-certs-cm")
SECRET = "argocd-secret"  # noqa: S105 - the object's name
WRITTEN = ("webhook.", "accounts.manager.")  # keys of that Secret; others stay where they are
PROJECT = "default"
NAMED_MAX = 3
# Deployments that the Job restarts, and the annotations of their pods that say for what.
RESTARTED = ("argocd-server", "argocd-applicationset-controller", "argocd-repo-server")
RESTARTED_FOR = ("robotkube.io/hook-secret", "robotkube.io/trusted-servers")
SHOWN = (("argocd-server-tls", ("ca.crt", "tls.crt")), (SECRET, ("tls.crt",)))  # its certificate: the first there is
Kubectl = Callable[..., str]
Object = Mapping[str, Any]


def keep(kubectl: Kubectl) -> None:
    """Keep what is there, if that was not done before. SetUpError while somebody uses the project that gets closed."""
    listed = _read(kubectl, "-n", NAMESPACE, "get", "applications.argoproj.io")["items"]
    using = [one["metadata"]["name"] for one in listed if one["spec"].get("project") == PROJECT]
    if using:
        named = f"{', '.join(using[:NAMED_MAX])}{' and others' if using[NAMED_MAX:] else ''}"
        raise SetUpError(
            f"Argo CD's project {PROJECT} is used by {named}, and the platform closes it: give these Applications a "
            "project of their own before"
        )
    if kubectl("-n", PLATFORM, "get", "secret", KEPT, "--ignore-not-found", "-o", "name"):
        return
    metadata = {"name": KEPT, "namespace": PLATFORM}
    data = {KEY: json.dumps(_present(kubectl))}
    secret = {"apiVersion": "v1", "kind": "Secret", "metadata": metadata, "stringData": data}
    kubectl("apply", "--server-side", "-f", "-", text=json.dumps(secret))


def give_back(kubectl: Kubectl) -> tuple[str, ...]:
    """Write what was kept, and take away what came since; a line for each object that changes. None where nothing was
    kept."""
    secret = kubectl("-n", PLATFORM, "get", "secret", KEPT, "--ignore-not-found", "-o", "json")
    if not secret:
        return ()
    before = json.loads(base64.b64decode(json.loads(secret)["data"][KEY]))
    changes = [(name, patch) for name, patch in patches(before, _present(kubectl)).items() if patch]
    for name, patch in changes:
        kubectl("-n", NAMESPACE, "patch", name, "--type=merge", "-p", json.dumps(patch))
    return tuple(f"{name} of Argo CD in namespace {NAMESPACE} is as before" for name, _ in changes)


def server_values(kubectl: Kubectl, spoken: ServerSpeech | None) -> dict[str, Any]:
    """What the platform's chart is told of argocd-server (`argocd.server`), so that managers reach it as it answers;
    nothing where the chart's own assumption holds, or nobody can say."""
    encrypted = spoken is not None and spoken.encrypted is True
    scheme = "https" if encrypted else "http"
    authorities = _shown(kubectl) if encrypted else ""
    known = {"authorities": authorities} if authorities else {}
    root = spoken.root if spoken and isinstance(spoken.root, str) else ""
    return {**known, "url": f"{scheme}://{SERVER}.{NAMESPACE}.svc/{root}"} if root else known


def _shown(kubectl: Kubectl) -> str:
    """PEM of what argocd-server shows, and of who signed it where that stands beside it; empty where there is none."""
    for name, keys in SHOWN:
        data = _one(kubectl, f"secret/{name}").get("data") or {}
        if data.get("tls.crt"):
            texts = (base64.b64decode(data[key]).decode().strip() for key in keys if data.get(key))
            return "".join(f"{text}\n" for text in dict.fromkeys(texts))
    return ""


def patches(before: Object, now: Object) -> dict[str, Object]:
    """The merge patch of each object (`kind/name`) that makes what it has `now` what it had `before`."""
    return {name: _patch(before.get(name, {}), value) for name, value in now.items()}


def _patch(before: Object, now: Object) -> dict[str, Any]:
    """A patch that brings back, by key, what was there, and None for what was not."""
    changed: dict[str, Any] = {key: None for key in now if key not in before}
    for key, value in before.items():
        other = now.get(key)
        if other == value:
            continue
        changed[key] = _patch(value, other) if isinstance(value, dict) and isinstance(other, dict) else value
    return {key: value for key, value in changed.items() if value != {}}


def _present(kubectl: Kubectl) -> dict[str, Any]:
    """What of each object the platform writes."""
    present: dict[str, Any] = {
        f"configmap/{name}": {"data": _one(kubectl, f"configmap/{name}").get("data") or {}} for name in MAPS
    }
    data = _one(kubectl, f"secret/{SECRET}").get("data") or {}
    present[f"secret/{SECRET}"] = {"data": {key: data[key] for key in data if key.startswith(WRITTEN)}}
    present[f"appproject/{PROJECT}"] = {"spec": _one(kubectl, f"appproject/{PROJECT}").get("spec") or {}}
    for name in RESTARTED:
        template = _one(kubectl, f"deployment/{name}").get("spec", {}).get("template", {})
        there = template.get("metadata", {}).get("annotations", {})
        annotations = {annotation: there.get(annotation) for annotation in RESTARTED_FOR}
        present[f"deployment/{name}"] = {"spec": {"template": {"metadata": {"annotations": annotations}}}}
    return present


def _one(kubectl: Kubectl, name: str) -> Object:
    item: Object = _read(kubectl, "-n", NAMESPACE, "get", name, "--ignore-not-found")
    return item


def _read(kubectl: Kubectl, *words: str) -> Any:
    return json.loads(kubectl(*words, "-o", "json") or "{}")
