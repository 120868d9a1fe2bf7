"""Admission: what webhooks and policies of the cluster do to the chart's objects, and whether the platform's are there.

Expressions of policies and what webhooks answer are not evaluated: which of them judge is said, and what they would
say is not known from here. Neither is whether the API server has policies from files: its objects do not show them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem, named
from robotkube.delivery.preflight.core.renderings import (
    Object,
    RenderedChart,
    enabled,
    group_of,
    labels_of,
    name_of,
    plural,
)
from robotkube.errors import InputError
from robotkube.foundation.kubernetes.core.network_policies import read_selector, selects
from robotkube.registry.admission.core.policies import API_POLICIES
from robotkube.registry.suites.core.pod_security import items, mapping

MUTATING_WEBHOOKS, WEBHOOKS = "MutatingWebhookConfiguration", "ValidatingWebhookConfiguration"
POLICIES, BINDINGS = "ValidatingAdmissionPolicy", "ValidatingAdmissionPolicyBinding"
MUTATING_POLICIES, MUTATING_BINDINGS = "MutatingAdmissionPolicy", "MutatingAdmissionPolicyBinding"
KINDS = (MUTATING_WEBHOOKS, WEBHOOKS, POLICIES, BINDINGS, MUTATING_POLICIES, MUTATING_BINDINGS)
NAME_LABEL = "kubernetes.io/metadata.name"
AGENT_LABEL = "robotkube.io/agent"
PART = {"app.kubernetes.io/part-of": "robotkube"}
OWN = "robotkube-"
ASKING = "helm template ... | kubectl apply --dry-run=server -f - asks them"
FILES = "policies that the API server reads from files it shows to nobody"
Labels = Mapping[str, str]


@dataclass(frozen=True)
class JudgedObjects:
    """Objects that may be judged: of a resource, with these labels, in a namespace with those. Objects of the whole
    cluster have none, and no selector of namespaces leaves them out, but for namespaces themselves."""

    group: str
    resource: str
    labels: Labels
    namespace: str
    namespace_labels: Labels | None


@dataclass(frozen=True)
class Judge:
    """What changes or judges requests: a webhook, or a policy with its binding. `stated`: who its selectors and rules
    are of."""

    kind: str
    name: str
    changes: bool
    stated: Sequence[Mapping[str, Any]]


Judges = Mapping[str, Sequence[Object]]
"""The objects of KINDS, by kind."""


def admission(
    rendering: RenderedChart,
    settings: Mapping[str, Any],
    namespaces: Mapping[str, Labels],
    present: Judges,
    installed: bool,
) -> CheckVerdict:
    """Nobody changes agents' pods on their way, and the platform's own policies are there where they are switched
    on."""
    targets = list(_targets(rendering, namespaces))
    judges = [judge for judge in _judges(present) if not judge.name.startswith(OWN)]
    touching = [judge for judge in judges if any(_matches(judge, target) for target in targets)]
    problems = [*_changing(touching, targets)] if mapping(settings.get("inspection")).get("enabled", True) else []
    if enabled(settings, "admission") and installed:
        problems += _absent(present)
    named_already = {problem.where for problem in problems}
    others = [f"{judge.kind} {judge.name}" for judge in touching if f"{judge.kind} {judge.name}" not in named_already]
    unseen = f"{named(others)} judge objects of the chart, and what they say is not known: {ASKING}" if others else ""
    words = "are written by the chart" if enabled(settings, "admission") else "are not written by the chart here"
    says = f"the platform's policies {words} (admission.enabled); {len(judges)} judges of others; {FILES}"
    return CheckVerdict(says, problems, unseen)


def _targets(rendering: RenderedChart, namespaces: Mapping[str, Labels]) -> Iterator[JudgedObjects]:
    seen = set()
    for item in rendering.objects:
        place = rendering.namespace_of(item)
        key = (group_of(item), plural(str(item.get("kind"))), place)
        if key not in seen:
            seen.add(key)
            around = _labels_in(place, rendering, namespaces) if place else None
            of_itself = labels_of(item) if item.get("kind") == "Namespace" else None
            yield JudgedObjects(*key[:2], labels_of(item), place, of_itself or around)
    pods = [(workload.namespace, mapping(workload.template.get("metadata"))) for workload in rendering.workloads]
    for place, metadata in pods:
        yield JudgedObjects(
            "", "pods", mapping(metadata.get("labels")), place, _labels_in(place, rendering, namespaces)
        )
    for place, of_agent in rendering.namespaces.items():
        if AGENT_LABEL in of_agent:
            own = {**PART, AGENT_LABEL: place}
            yield JudgedObjects("", "pods", own, place, _labels_in(place, rendering, namespaces))


def _labels_in(place: str, rendering: RenderedChart, namespaces: Mapping[str, Labels]) -> Labels:
    return {**namespaces.get(place, {}), **rendering.namespaces.get(place, {}), NAME_LABEL: place}


def _judges(present: Judges) -> Iterator[Judge]:
    for kind in (MUTATING_WEBHOOKS, WEBHOOKS):
        for item in present.get(kind, ()):
            hooks = items(item.get("webhooks"))
            yield Judge(kind, name_of(item), kind == MUTATING_WEBHOOKS, hooks)
    for kind, bindings in ((POLICIES, BINDINGS), (MUTATING_POLICIES, MUTATING_BINDINGS)):
        for item in present.get(kind, ()):
            bound = [mapping(one.get("spec")) for one in present.get(bindings, ()) if _binds(one, name_of(item), kind)]
            constraints = mapping(mapping(item.get("spec")).get("matchConstraints"))
            stated = [{**constraints, "also": mapping(one.get("matchResources"))} for one in bound]
            yield Judge(kind, name_of(item), kind == MUTATING_POLICIES, stated)


def _binds(binding: Object, policy: str, kind: str) -> bool:
    """Return whether a binding has its policy refuse or change something: one that warns or audits does neither."""
    spec = mapping(binding.get("spec"))
    return spec.get("policyName") == policy and (kind != POLICIES or "Deny" in (spec.get("validationActions") or ()))


def _matches(judge: Judge, target: JudgedObjects) -> bool:
    return any(_concerns(one, target) and _selected(mapping(one.get("also")), target) for one in judge.stated)


def _concerns(stated: Mapping[str, Any], target: JudgedObjects) -> bool:
    rules = items(stated.get("rules")) or items(stated.get("resourceRules"))
    return any(_ruled(rule, target) for rule in rules) and _selected(stated, target)


def _ruled(rule: Mapping[str, Any], target: JudgedObjects) -> bool:
    operations, groups, resources = (set(rule.get(key) or ()) for key in ("operations", "apiGroups", "resources"))
    return (
        bool({"*", "CREATE", "UPDATE"} & operations)
        and bool({"*", target.group} & groups)
        and bool({"*", "*/*", target.resource} & resources)
    )


def _selected(stated: Mapping[str, Any], target: JudgedObjects) -> bool:
    """Return whether both selectors take the target; one that is not understood does."""
    for key, known in (("namespaceSelector", target.namespace_labels), ("objectSelector", target.labels)):
        try:
            if known is not None and not selects(read_selector(stated.get(key) or {}, key), known):
                return False
        except InputError:
            continue
    return True


def _changing(judges: Sequence[Judge], targets: Sequence[JudgedObjects]) -> Iterator[Problem]:
    pods = [target for target in targets if target.resource == "pods" and AGENT_LABEL in target.labels]
    for judge in judges:
        places = sorted({pod.namespace for pod in pods if judge.changes and _matches(judge, pod)})
        if places:
            yield Problem(
                f"it changes pods of agents {named(places)} as they are made",
                f"{judge.kind} {judge.name}",
                "the inspector compares pods with what main renders: such pods are strangers, and a remover ends them",
                "leave namespaces with the label robotkube.io/agent out of its namespaceSelector, or set "
                "inspection.enabled: false",
            )


def _absent(present: Judges) -> Iterator[Problem]:
    policies = {name_of(one) for one in present.get(POLICIES, ())}
    bound = {mapping(one.get("spec")).get("policyName") for one in present.get(BINDINGS, ())}
    for name in API_POLICIES:
        if name not in policies or name not in bound:
            lacking = "policy" if name not in policies else "binding"
            yield Problem(
                f"there is no {lacking} {name}",
                f"{POLICIES} {name}",
                "admission.enabled is true, and images that nobody verified start without it",
                "kubectl --namespace robotkube logs deployment/admission says why it was not written",
            )
