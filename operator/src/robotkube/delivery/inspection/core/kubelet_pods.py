"""Pods as a kubelet lists them: what it was told to run (`/pods`) and what its runtime has (`/runningpods/`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from robotkube.foundation.documents.core.patterns import DIGEST

SOURCE = "kubernetes.io/config.source"
API_SOURCE = "api"
RELEASE_LABEL = "app.kubernetes.io/instance"
ORDINARY, INIT, EPHEMERAL = "containers", "initContainers", "ephemeralContainers"
KINDS = (ORDINARY, INIT, EPHEMERAL)
STATUSES = {ORDINARY: "containerStatuses", INIT: "initContainerStatuses", EPHEMERAL: "ephemeralContainerStatuses"}
FINISHED = ("Succeeded", "Failed")
GRACE_SECONDS_MAX = 300  # of a pod that ends: one that takes longer is judged like others

Object = Mapping[str, Any]


@dataclass(frozen=True)
class Container:
    """A container of a pod: `image` as the pod names it, `running_digest` of the image that its runtime says it runs
    (empty when it does not run yet, or when the runtime knows no digest)."""

    name: str
    image: str
    kind: str = ORDINARY
    running_digest: str = ""
    spec: Object | None = None


@dataclass(frozen=True)
class KubeletPod:
    """A pod of a kubelet's list. `owner` is the kind and name of the controller that made it (both empty: none did);
    `ends` the time in seconds by which it is to have ended, None while it is not being deleted."""

    uid: str
    namespace: str
    name: str
    containers: tuple[Container, ...]
    static: bool = False
    finished: bool = False
    ends: float | None = None
    release: str = ""
    owner: tuple[str, str] = ("", "")
    volume_images: tuple[str, ...] = ()
    spec: Object | None = None
    labels: Object = field(default_factory=dict)
    annotations: Object = field(default_factory=dict)

    @property
    def names(self) -> frozenset[str]:
        """Names of all its containers."""
        return frozenset(container.name for container in self.containers)


@dataclass(frozen=True)
class RuntimePod:
    """What a node's runtime has under a pod's identity: the names of its running containers with their images."""

    uid: str
    namespace: str
    name: str
    containers: tuple[tuple[str, str], ...]


def read_pods(document: Object, digests: bool) -> tuple[KubeletPod, ...]:
    """The pods in a kubelet's list. `digests`: whether its runtime says by which digest an image was named (containerd
    does; others may say that of one platform's part of it)."""
    return tuple(_pod(item, digests) for item in document.get("items") or ())


def read_runtime_pods(document: Object) -> tuple[RuntimePod, ...]:
    """The pods in a kubelet's list of what runs."""
    return tuple(_runtime_pod(item) for item in document.get("items") or ())


def _runtime_pod(item: Object) -> RuntimePod:
    metadata = item.get("metadata") or {}
    containers = (item.get("spec") or {}).get("containers") or ()
    named = tuple((str(entry.get("name", "")), str(entry.get("image", ""))) for entry in containers)
    return RuntimePod(_text(metadata, "uid"), _text(metadata, "namespace"), _text(metadata, "name"), named)


def _text(metadata: Object, key: str) -> str:
    return str(metadata.get(key, ""))


def _pod(item: Object, digests: bool) -> KubeletPod:
    metadata = item.get("metadata") or {}
    spec = item.get("spec") or {}
    status = item.get("status") or {}
    labels = metadata.get("labels") or {}
    annotations = metadata.get("annotations") or {}
    volumes = (volume.get("image") for volume in spec.get("volumes") or ())
    return KubeletPod(
        uid=_text(metadata, "uid"),
        namespace=_text(metadata, "namespace"),
        name=_text(metadata, "name"),
        containers=tuple(_containers(spec, status if digests else {})),
        static=annotations.get(SOURCE, API_SOURCE) != API_SOURCE,
        finished=status.get("phase") in FINISHED,
        ends=_end(metadata),
        release=str(labels.get(RELEASE_LABEL, "")),
        owner=_owner(metadata),
        volume_images=tuple(str(image.get("reference", "")) for image in volumes if image),
        spec=spec,
        labels=labels,
        annotations=annotations,
    )


def _containers(spec: Object, status: Object) -> Iterable[Container]:
    for kind in KINDS:
        statuses = {entry.get("name"): entry for entry in status.get(STATUSES[kind]) or ()}
        for entry in spec.get(kind) or ():
            name = str(entry.get("name", ""))
            yield Container(name, str(entry.get("image", "")), kind, _running_digest(statuses.get(name)), entry)


def _running_digest(status: Object | None) -> str:
    if not status or "running" not in (status.get("state") or {}):
        return ""
    repository, _, digest = str(status.get("imageID", "")).rpartition("@")
    return digest if repository and DIGEST.fullmatch(digest) else ""


def _owner(metadata: Object) -> tuple[str, str]:
    owners = (owner for owner in metadata.get("ownerReferences") or () if owner.get("controller"))
    owner: Object = next(owners, {})
    return str(owner.get("kind", "")), str(owner.get("name", ""))


def _end(metadata: Object) -> float | None:
    """The moment by which a pod that is being deleted is to have ended. None for one that may take longer than any of
    ours."""
    text = metadata.get("deletionTimestamp")
    if not text or int(metadata.get("deletionGracePeriodSeconds") or 0) > GRACE_SECONDS_MAX:
        return None
    return datetime.fromisoformat(str(text).replace("Z", "+00:00")).timestamp()
