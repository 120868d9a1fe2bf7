"""What may run, as Git and the OCI registry say it: images by digest, and releases with what their charts render."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.registry.admission.core.allowed import Allowed
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.core.stranded import is_listed

Object = Mapping[str, Any]

CHARTS_KIND = "Deployment"  # the one kind of workload that releases are made of


@dataclass(frozen=True)
class ReleaseShape:
    """The workloads of a release by name: as main has it now, and as it had it before, newest first. `unknown` says why
    they are not known now; then `workloads` is empty."""

    workloads: Mapping[str, Object]
    earlier: Sequence[Mapping[str, Object]] = ()
    unknown: str = ""

    def versions(self, name: str) -> tuple[Object, ...]:
        """What a workload of this name may look like, today's first."""
        return tuple(shape[name] for shape in (self.workloads, *self.earlier) if name in shape)

    @property
    def all(self) -> tuple[Object, ...]:
        """Every workload that main has or had."""
        return tuple(item for shape in (self.workloads, *self.earlier) for item in shape.values())


@dataclass(frozen=True)
class Permitted:
    """What may run. `lately`: images that were listed a moment ago: what runs them is being replaced. `releases` by
    `<namespace>/<name>`, with those that main had a moment ago and that are being taken away."""

    domain: Domain
    allowed: Allowed
    releases: Mapping[str, ReleaseShape] = field(default_factory=dict)
    lately: frozenset[str] = frozenset()

    def image(self, reference: str, namespace: str) -> bool:
        """Whether an image may run in a namespace."""
        listed = is_listed(reference, namespace, self.domain, self.allowed)
        return listed or (namespace in self.domain.agents and reference.partition("@")[2] in self.lately)

    def release(self, namespace: str, name: str) -> ReleaseShape | None:
        """A release that main has."""
        return self.releases.get(f"{namespace}/{name}")

    def is_ours(self, namespace: str) -> bool:
        """Whether a namespace is one of agents, tests, the platform or Argo CD."""
        domain = self.domain
        return namespace in (*domain.agents, *domain.tests, domain.platform, domain.argocd)
