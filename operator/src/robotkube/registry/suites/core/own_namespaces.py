"""Test namespaces that somebody makes with their own rights, as copies of the platform's: which objects they have,
which rights that takes, and which of them were left behind.

Nothing in them but a volume claim differs from a test namespace of the platform: quota, limits, accounts, and network
policies are those that stand there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.times import time_ns, time_text
from robotkube.foundation.kubernetes.core.access_rights import ApiRight
from robotkube.registry.suites.core.namespace_contents import SCRATCH_VOLUME_CLAIM

Object = Mapping[str, Any]

PREFIX = "robotkube-try-"
LABEL = "robotkube.io/try"
UNTIL = "robotkube.io/try-until"
MAKER = "robotkube.io/try-maker"
POD_SECURITY = "pod-security.kubernetes.io/enforce"
READER = "configuration-reader"  # the one Role that pods of a chart have
RBAC, NETWORK = "rbac.authorization.k8s.io", "networking.k8s.io"
DATABASE_SECRET = "database-account"  # noqa: S105 - its name
CONTENT = ("spec", "rules", "roleRef", "automountServiceAccountToken")


@dataclass(frozen=True)
class Copied:
    """A kind of objects that a test namespace of the platform has: `group` of its API, `only` of this name."""

    kind: str
    group: str
    plural: str
    only: str = ""

    @property
    def path(self) -> str:
        """The path of a namespace's list, with {} for the namespace."""
        base = f"/apis/{self.group}/v1" if self.group else "/api/v1"
        return f"{base}/namespaces/{{}}/{self.plural}"


KINDS = (
    Copied("ResourceQuota", "", "resourcequotas"),
    Copied("LimitRange", "", "limitranges"),
    Copied("ServiceAccount", "", "serviceaccounts"),
    Copied("Role", RBAC, "roles", READER),
    Copied("RoleBinding", RBAC, "rolebindings", READER),
    Copied("NetworkPolicy", NETWORK, "networkpolicies"),
)
NAMESPACE_VERBS = ("create", "get", "list", "delete")
RUNS: Sequence[tuple[str, str, str]] = (
    ("apps", "deployments", "create get list watch patch delete"),
    ("", "configmaps", "create get list watch patch delete"),
    ("", "pods", "create get list watch delete"),
    ("", "pods/log", "get"),
    ("", "secrets", "create delete"),
    ("", "events", "list"),
)


def needed_rights(own: str, source: str) -> tuple[ApiRight, ...]:
    """What somebody must be allowed who makes `own` as a copy of `source` and runs suites there."""
    return (
        *(ApiRight(verb, "", "namespaces") for verb in NAMESPACE_VERBS),
        *(ApiRight("list", kind.group, kind.plural, source) for kind in KINDS),
        *(ApiRight("create", kind.group, kind.plural, own) for kind in KINDS),
        *(ApiRight(verb, group, resource, own) for group, resource, verbs in RUNS for verb in verbs.split()),
    )


def namespace_document(name: str, maker: str, until_ns: int) -> Object:
    """The namespace; `maker` is the program that removes it, which it does before `until_ns`."""
    labels = {LABEL: "true", POD_SECURITY: "restricted"}
    annotations = {MAKER: maker, UNTIL: time_text(until_ns)}
    metadata = {"name": name, "labels": labels, "annotations": annotations}
    return {"apiVersion": "v1", "kind": "Namespace", "metadata": metadata}


def copies(kind: Copied, items: Sequence[Object], namespace: str) -> Iterator[Object]:
    """The objects of a kind as they are made in another namespace; accounts that Kubernetes makes are left out."""
    version = f"{kind.group}/v1" if kind.group else "v1"
    for item in items:
        name = item["metadata"]["name"]
        if name == "default" or kind.only not in ("", name):
            continue
        metadata = {"name": name, "namespace": namespace}
        document: dict[str, Any] = {"apiVersion": version, "kind": kind.kind, "metadata": metadata}
        document |= {key: item[key] for key in CONTENT if key in item}
        if "subjects" in item:
            document["subjects"] = [{**subject, "namespace": namespace} for subject in item["subjects"]]
        yield document


def is_left_behind(item: Object, now_ns: int, lives: Callable[[str], bool]) -> bool:
    """Return whether a namespace is a copy whose maker will not remove it any more: its time is over, or `lives(maker)`
    says that it has ended."""
    metadata = item["metadata"]
    if not metadata["name"].startswith(PREFIX) or (metadata.get("labels") or {}).get(LABEL) != "true":
        return False
    annotations = metadata.get("annotations") or {}
    try:
        over = time_ns(str(annotations.get(UNTIL, ""))) < now_ns
    except ValueError:
        over = True
    return over or not lives(str(annotations.get(MAKER, "")))


def lacking(secrets: set[str], objects: Sequence[Object]) -> str:
    """What a chart's objects need, or Secrets that they mount, and a copy does not have; empty when it has all."""
    if DATABASE_SECRET in secrets:
        return "it needs a database, whose account the suite-runner makes from inside of the cluster"
    if any(SCRATCH_VOLUME_CLAIM in claims for claims in map(_claims, objects)):
        return f"it mounts the volume claim {SCRATCH_VOLUME_CLAIM}, which the platform's test namespaces alone have"
    return ""


def _claims(item: Object) -> set[str]:
    pod = ((item.get("spec") or {}).get("template") or {}).get("spec") or {}
    volumes = pod.get("volumes") or ()
    return {str((volume.get("persistentVolumeClaim") or {}).get("claimName", "")) for volume in volumes}
