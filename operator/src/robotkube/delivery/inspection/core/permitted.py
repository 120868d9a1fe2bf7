"""What may run, as Git and the OCI registry say it: images by digest, and releases with what their charts render."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.registry.admission.core.allowed import Allowed
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.core.stranded import is_listed

Object = Mapping[str, Any]

CHARTS_KIND = "Deployment"  # the one kind of workload that releases are made of
SETTINGS_KIND = "ConfigMap"


def place(kind: str, name: str) -> str:
    """How an object of a release is named among its workloads: a Deployment by its name alone."""
    return name if kind == CHARTS_KIND else f"{kind}/{name}"


@dataclass(frozen=True)
class ReleaseShape:
    """The workloads of a release by name, and its ConfigMaps by `place`: as main has it now, and as it had it before,
    newest first: Argo CD applies what main says a moment later, and a pod stays until the one that replaces it is
    ready. Settings follow sooner: `lately` is how many of the earlier ones they may still be, newest first; None: all.
    `chart` is `<name>@<digest>`. `unknown` says why its workloads are not known now; then there are none."""

    name: str
    chart: str
    workloads: Mapping[str, Object]
    earlier: Sequence[Mapping[str, Object]] = ()
    unknown: str = ""
    lately: int | None = None

    def versions(self, workload: str) -> Iterator[Object]:
        """What a workload of this name may look like, today's first."""
        if workload in self.workloads:
            yield self.workloads[workload]
        yield from (shape[workload] for shape in self.earlier if workload in shape)

    def settings(self, key: str) -> Iterator[Object]:
        """What a ConfigMap may say, today's first. Only today's once main has had it for a while; all when today's has
        none of that name."""
        if key not in self.workloads:
            yield from self.versions(key)
            return
        yield self.workloads[key]
        yield from (shape[key] for shape in self.earlier[: self.lately] if key in shape)


@dataclass(frozen=True)
class Permitted:
    """What may run. `releases` by namespace, with those that main had a moment ago and that are being taken away.
    `installed`: references of the platform's images as it was installed with, where they name no digest. `lately`:
    images and charts that were listed a moment ago: what runs them is being replaced."""

    domain: Domain
    allowed: Allowed
    releases: Mapping[str, Sequence[ReleaseShape]] = field(default_factory=dict)
    installed: frozenset[str] = frozenset()
    lately: frozenset[str] = frozenset()

    def image(self, reference: str, namespace: str) -> bool:
        """Return whether an image may run in a namespace."""
        if is_listed(reference, namespace, self.domain, self.allowed) or not self.is_judged(namespace):
            return True
        if namespace in self.domain.agents:
            return reference.partition("@")[2] in self.lately
        return namespace not in self.domain.tests and reference in self.installed

    def chart(self, chart: str) -> bool:
        """Return whether releases may be of a chart."""
        return chart in self.allowed.charts or chart in self.lately

    def release(self, namespace: str, workload: str, label: str = "") -> ReleaseShape | None:
        """The release that a workload is of: the one whose chart renders it, else one of the name `label` of which that
        is not known now."""
        shapes = self.releases.get(namespace, ())
        rendering = (shape for shape in shapes if any(True for _ in shape.versions(workload)))
        unknown = (shape for shape in shapes if shape.unknown and shape.name == label)
        return next(rendering, None) or next(unknown, None)

    def is_judged(self, namespace: str) -> bool:
        """Return whether images and makers of pods matter there: Argo CD and others are known where the cluster is
        ours."""
        domain = self.domain
        return domain.elsewhere or namespace in (*domain.agents, *domain.tests, *domain.of_the_platform)

    def is_ours(self, namespace: str) -> bool:
        """Return whether a namespace is one of agents, tests, the platform, its gate or Argo CD."""
        domain = self.domain
        return namespace in (*domain.agents, *domain.tests, *domain.of_the_platform, domain.argocd)
