"""The chart as it is rendered with the values: its objects, with their kinds as the API names them, and its pods."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.registry.suites.core.pod_security import Pod, items, mapping

Object = Mapping[str, Any]

HOOK = "helm.sh/hook"
BEFORE_DELETION = "pre-delete"
WORKLOADS = ("Deployment", "StatefulSet", "DaemonSet", "Job")
OF_THE_CLUSTER = frozenset(
    {"Namespace", "ClusterRole", "ClusterRoleBinding", "CustomResourceDefinition", "PriorityClass", "StorageClass"}
)


@dataclass(frozen=True)
class Workload:
    """One object that has pods: `replicas` of them are there at the same time, in `namespace`."""

    kind: str
    name: str
    namespace: str
    replicas: int
    template: Object
    hook: str

    @property
    def place(self) -> str:
        """It, in words."""
        return f"{self.kind} {self.namespace}/{self.name}"

    @property
    def pod(self) -> Pod:
        """Its pod."""
        metadata = mapping(self.template.get("metadata"))
        return Pod(self.place, mapping(metadata.get("annotations")), mapping(self.template.get("spec")))


@dataclass(frozen=True)
class RenderedChart:
    """The objects of the chart; those without a namespace are in `namespace`, that of the release."""

    objects: Sequence[Object]
    release: str
    namespace: str

    def of_kind(self, *kinds: str) -> Iterator[Object]:
        """The objects of these kinds."""
        return (item for item in self.objects if item.get("kind") in kinds)

    def namespace_of(self, item: Object) -> str:
        """The namespace that an object belongs to; empty for the whole cluster."""
        if item.get("kind") in OF_THE_CLUSTER:
            return ""
        return str(metadata_of(item).get("namespace") or self.namespace)

    @functools.cached_property
    def workloads(self) -> tuple[Workload, ...]:
        """Everything that has pods."""
        return tuple(self._workload(item) for item in self.of_kind(*WORKLOADS))

    @functools.cached_property
    def namespaces(self) -> Mapping[str, Mapping[str, str]]:
        """The namespaces that the chart makes, with their labels."""
        return {str(metadata_of(item).get("name")): labels_of(item) for item in self.of_kind("Namespace")}

    def _workload(self, item: Object) -> Workload:
        spec = mapping(item.get("spec"))
        return Workload(
            kind=str(item.get("kind")),
            name=str(metadata_of(item).get("name")),
            namespace=self.namespace_of(item),
            replicas=int(spec.get("replicas", 1)),
            template=mapping(spec.get("template")),
            hook=str(annotations_of(item).get(HOOK, "")),
        )


def metadata_of(item: Object) -> Mapping[str, Any]:
    """The metadata of an object."""
    return mapping(item.get("metadata"))


def labels_of(item: Object) -> Mapping[str, str]:
    """The labels of an object."""
    return mapping(metadata_of(item).get("labels"))


def annotations_of(item: Object) -> Mapping[str, str]:
    """The annotations of an object."""
    return mapping(metadata_of(item).get("annotations"))


def name_of(item: Object) -> str:
    """The name of an object."""
    return str(metadata_of(item).get("name", ""))


def group_of(item: Object) -> str:
    """The API group of an object; empty for the core."""
    group, separator, _ = str(item.get("apiVersion", "")).partition("/")
    return group if separator else ""


def plural(kind: str) -> str:
    """The resource of a kind, as Kubernetes' API conventions form it; a test compares it with what a server serves."""
    word = kind.lower()
    if word.endswith("y"):
        return f"{word[:-1]}ies"
    return f"{word}es" if word.endswith("s") else f"{word}s"


def agents(settings: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """The agents that the values declare."""
    return items(settings.get("agents"))


def enabled(settings: Mapping[str, Any], part: str) -> bool:
    """Return whether the values switch this part on."""
    return mapping(settings.get(part)).get("enabled") is True
