"""Takes away what an installation added to a cluster that was not made here: the Helm release and what it keeps, Argo
CD if it came with it, and the namespaces; an Argo CD of others gets back what it had."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ci import given_argocd
from ci.errors import SetUpError
from ci.installation import ARGOCD, HELMS_OWN, NAMESPACE, Installer
from gitops.argocd.render import READER
from robotkube.delivery.preflight.core.argocd import DEFINITIONS

MANAGED = "app.kubernetes.io/managed-by=Helm"
NAMESPACES = "Namespace"
KEPT_KINDS = (
    "Namespace",
    "CustomResourceDefinition",
    "Lease",
    "Secret",
    "ConfigMap",
    "PersistentVolumeClaim",
)
"""Kinds of which the chart has Helm keep any."""
UNINSTALL_SECONDS_MAX = 300
GONE_SECONDS_MAX = 300
ANSWER_SECONDS_MAX = 120
OF_ARGOCD = (
    *(("CustomResourceDefinition", name) for name in DEFINITIONS),
    ("ClusterRoleBinding", READER),
    ("ClusterRole", READER),
)
Object = Mapping[str, Any]


def remove(installer: Installer, added: Mapping[str, str]) -> tuple[str, ...]:
    """Remove it, and wait until it is gone; a line for each thing. `added`: annotations of namespaces that were made
    before the chart. SetUpError says what could not be removed."""
    lines = [*_release(installer), *given_argocd.give_back(installer.kubectl)]
    left = _kept_by_helm(installer)
    namespaces = _namespaces(installer, left, added)
    own_argocd = ARGOCD in namespaces
    going = [*_outside(left, namespaces), *((kind, name, "") for kind, name in OF_ARGOCD if own_argocd)]
    going += [(NAMESPACES, name, "") for name in namespaces]
    for kind, name, namespace in sorted(going, key=lambda one: one[0] == "CustomResourceDefinition"):
        where = ("-n", namespace) if namespace else ()
        installer.kubectl(*where, "delete", kind.lower(), name, "--ignore-not-found", "--wait=false")
    _wait_gone(installer, going)
    return (*lines, *(f"{kind} {f'{namespace}/' if namespace else ''}{name}" for kind, name, namespace in going))


def goes(installer: Installer, added: Mapping[str, str]) -> str:
    """The sentence that names the namespaces that `remove` would take away, and the volume claims that go with them."""
    namespaces = _namespaces(installer, _kept_by_helm(installer), added)
    volume_claims = json.loads(installer.kubectl("get", "persistentvolumeclaims", "-A", "-o", "json"))["items"]
    places = ((claim["metadata"]["namespace"], claim["metadata"]["name"]) for claim in volume_claims)
    names = [f"{namespace}/{name}" for namespace, name in places if namespace in namespaces]
    lost = f", and what is in volume claims {', '.join(names)}" if names else ""
    return f"what was installed goes, with namespaces {', '.join(namespaces)}{lost}"


def _namespaces(installer: Installer, kept: Sequence[Object], added: Mapping[str, str]) -> list[str]:
    """Those of the release that Helm leaves, and those that were made before it."""
    return list(dict.fromkeys([*_named(kept, NAMESPACES), *_with(installer, added)]))


def _release(installer: Installer) -> Iterator[str]:
    """Uninstall the release: its own Job first lets releases of agents end."""
    there = installer.helm("-n", NAMESPACE, "list", "--all", "--short", seconds=ANSWER_SECONDS_MAX).split()
    if NAMESPACE not in there:
        return
    options = ("--wait", "--timeout", f"{UNINSTALL_SECONDS_MAX}s")
    try:
        installer.helm("-n", NAMESPACE, "uninstall", NAMESPACE, *options, seconds=UNINSTALL_SECONDS_MAX + 30)
    except SetUpError as error:
        raise SetUpError(f"{error}\n{installer.state(NAMESPACE)}\nrepair what is named, and try again") from error
    yield f"Helm release {NAMESPACE}/{NAMESPACE}"


def _kept_by_helm(installer: Installer) -> list[Object]:
    """Objects of the release that Helm leaves."""
    words = ("get", ",".join(KEPT_KINDS), "-A", "-l", MANAGED, "-o", "json", "--ignore-not-found")
    managed = json.loads(installer.kubectl(*words, seconds=ANSWER_SECONDS_MAX) or '{"items": []}')["items"]
    return [one for one in managed if HELMS_OWN.items() <= one["metadata"].get("annotations", {}).items()]


def _named(objects: Sequence[Object], kind: str) -> list[str]:
    return [str(one["metadata"]["name"]) for one in objects if one["kind"] == kind]


def _with(installer: Installer, annotations: Mapping[str, str]) -> list[str]:
    """Namespaces that have these annotations."""
    namespaces = json.loads(installer.kubectl("get", "namespaces", "-o", "json"))["items"]
    chosen = (
        namespace["metadata"]
        for namespace in namespaces
        if annotations.items() <= namespace["metadata"].get("annotations", {}).items()
    )
    return [str(one["name"]) for one in chosen]


def _outside(objects: Sequence[Object], namespaces: Sequence[str]) -> list[tuple[str, str, str]]:
    """Kind, name and namespace of what does not go with one of these namespaces."""
    names = ((one["kind"], one["metadata"]["name"], one["metadata"].get("namespace", "")) for one in objects)
    return [one for one in names if one[0] != NAMESPACES and one[2] not in namespaces]


def _wait_gone(installer: Installer, going: Sequence[tuple[str, str, str]]) -> None:
    for kind, name, namespace in going:
        where = ("-n", namespace) if namespace else ()
        wait = ("wait", "--for=delete", f"{kind.lower()}/{name}", f"--timeout={GONE_SECONDS_MAX}s")
        installer.kubectl(*where, *wait, seconds=GONE_SECONDS_MAX + 10)
