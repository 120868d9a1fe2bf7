"""The checks of the preflight: each takes facts by name, and gives a verdict. What was not read is never ok."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.preflight.core.admission import admission
from robotkube.delivery.preflight.core.agents import agents_nodes, agents_ready, control_groups
from robotkube.delivery.preflight.core.argocd import argocd
from robotkube.delivery.preflight.core.capacity import capacity
from robotkube.delivery.preflight.core.findings import (
    FAILED,
    NOT_CHECKED,
    OK,
    CheckVerdict,
    ClusterFinding,
    Unread,
    gathered,
)
from robotkube.delivery.preflight.core.kinds import api_kinds, kubernetes_version
from robotkube.delivery.preflight.core.owners import owners
from robotkube.delivery.preflight.core.pod_security import pod_security
from robotkube.delivery.preflight.core.registries import registries
from robotkube.delivery.preflight.core.releases import release
from robotkube.delivery.preflight.core.rights import rights
from robotkube.delivery.preflight.core.storage import storage
from robotkube.delivery.preflight.core.values import values

Facts = Mapping[str, Any]
"""What was read, by name; Unread where it could not be."""


@dataclass(frozen=True)
class ClusterCheck:
    """One check: `judge` gets the facts that it `needs`, in this order. What it proves: docs/reference/preflight.md."""

    name: str
    judge: Callable[..., CheckVerdict]
    needs: tuple[str, ...]

    def finding(self, facts: Facts) -> ClusterFinding:
        """What it finds in the facts."""
        unread = [fact.why for fact in (facts[name] for name in self.needs) if isinstance(fact, Unread)]
        if unread:
            return ClusterFinding(self.name, NOT_CHECKED, "; ".join(dict.fromkeys(unread)))
        verdict = self.judge(*(facts[name] for name in self.needs))
        said = "; ".join(filter(None, (verdict.says, verdict.unseen)))
        result = FAILED if verdict.problems else NOT_CHECKED if verdict.unseen else OK
        return ClusterFinding(self.name, result, said, gathered(verdict.problems))


CHECKS = (
    ClusterCheck("values", values, ("judgement", "settings")),
    ClusterCheck("version", kubernetes_version, ("chart", "version")),
    ClusterCheck("kinds", api_kinds, ("rendering", "settings", "served")),
    ClusterCheck("rights", rights, ("rights",)),
    ClusterCheck("owners", owners, ("rendering", "standing", "namespaces")),
    ClusterCheck("release", release, ("chart", "rendering", "release", "namespace")),
    ClusterCheck("storage", storage, ("rendering", "storage")),
    ClusterCheck("pod-security", pod_security, ("rendering", "namespaces")),
    ClusterCheck("admission", admission, ("rendering", "settings", "namespaces", "judges", "installed")),
    ClusterCheck("agents", agents_nodes, ("settings", "nodes")),
    ClusterCheck("agents-ready", agents_ready, ("settings", "nodes")),
    ClusterCheck("capacity", capacity, ("rendering", "nodes", "pods")),
    ClusterCheck("control-groups", control_groups, ("control_groups", "nodes")),
    ClusterCheck("argocd", argocd, ("argocd", "settings")),
    ClusterCheck("registries", registries, ("registries",)),
)


def findings(facts: Facts, checks: Sequence[ClusterCheck] = CHECKS) -> Sequence[ClusterFinding]:
    """The findings of these checks."""
    return [check.finding(facts) for check in checks]
