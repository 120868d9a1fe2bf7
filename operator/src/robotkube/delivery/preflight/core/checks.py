"""The checks of the preflight: each takes facts by name, and gives a verdict. What was not read is never ok."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.preflight.core.admission import admission
from robotkube.delivery.preflight.core.agents import agents_nodes, agents_ready, control_groups
from robotkube.delivery.preflight.core.argocd import argocd
from robotkube.delivery.preflight.core.capacity import capacity
from robotkube.delivery.preflight.core.findings import FAILED, NOT_CHECKED, OK, Finding, Unread, Verdict, gathered
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
class Check:
    """One check: `judge` gets the facts that it `needs`, in this order. `about` says what it proves."""

    name: str
    judge: Callable[..., Verdict]
    needs: tuple[str, ...]
    about: str

    def finding(self, facts: Facts) -> Finding:
        """What it finds in the facts."""
        unread = [fact.why for fact in (facts[name] for name in self.needs) if isinstance(fact, Unread)]
        if unread:
            return Finding(self.name, NOT_CHECKED, "; ".join(dict.fromkeys(unread)))
        verdict = self.judge(*(facts[name] for name in self.needs))
        said = "; ".join(filter(None, (verdict.says, verdict.unseen)))
        result = FAILED if verdict.problems else NOT_CHECKED if verdict.unseen else OK
        return Finding(self.name, result, said, gathered(verdict.problems))


CHECKS = (
    Check("values", values, ("judgement", "settings"), "schema and rules of the chart take the values"),
    Check("version", kubernetes_version, ("chart", "version"), "the API server is no older than `kubeVersion` says"),
    Check("kinds", api_kinds, ("rendering", "settings", "served"), "every kind that is rendered is served"),
    Check("rights", rights, ("rights",), "the account may do all that Helm does with the chart"),
    Check(
        "owners", owners, ("rendering", "standing", "namespaces"), "nothing of another release has the chart's names"
    ),
    Check(
        "release", release, ("chart", "rendering", "release", "namespace"), "Helm can go on from the present release"
    ),
    Check("storage", storage, ("rendering", "storage"), "each volume claim has a StorageClass, and access modes fit"),
    Check("pod-security", pod_security, ("rendering", "namespaces"), "no namespace refuses the platform's pods"),
    Check(
        "admission",
        admission,
        ("rendering", "settings", "namespaces", "judges", "installed"),
        "no webhook or policy changes agents' pods; the platform's own policies are there",
    ),
    Check("agents", agents_nodes, ("settings", "nodes"), "each agent has a Node, by labels that the values know"),
    Check("agents-ready", agents_ready, ("settings", "nodes"), "the Nodes of agents are Ready and take pods"),
    Check("capacity", capacity, ("rendering", "nodes", "pods"), "the platform's pods find Nodes with enough free"),
    Check("control-groups", control_groups, ("control_groups",), "Nodes have control groups of version 2"),
    Check("argocd", argocd, ("argocd",), "Argo CD is there, in a tested version, and runs"),
    Check("registries", registries, ("registries",), "the images' registries answer from here"),
)


def findings(facts: Facts) -> Sequence[Finding]:
    """The findings of all checks."""
    return [check.finding(facts) for check in CHECKS]
