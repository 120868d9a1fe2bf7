"""Pod Security: whether the levels that namespaces enforce let the chart's pods in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem, named
from robotkube.delivery.preflight.core.renderings import RenderedChart, Workload
from robotkube.registry.suites.core.pod_security import RULES, Pod

ENFORCE = "pod-security.kubernetes.io/enforce"
PRIVILEGED, BASELINE, RESTRICTED = "privileged", "baseline", "restricted"
RESTRICTED_ALONE = frozenset(
    {"privilege-escalation", "run-as-non-root", "run-as-user", "seccomp", "capabilities", "volume-types"}
)
HOST_FOLDER = "type hostPath"
Labels = Mapping[str, Mapping[str, str]]
"""The labels of namespaces, by name."""


def pod_security(rendering: RenderedChart, namespaces: Labels) -> CheckVerdict:
    """No namespace refuses a pod of the chart. Where no level stands, that of the API server counts, which cannot be
    read; pods that meet `restricted` are let in whatever it is."""
    problems: list[Problem] = []
    unknown = set()
    for workload in rendering.workloads:
        level = level_of(workload.namespace, rendering, namespaces)
        if level in (BASELINE, RESTRICTED):
            problems += _refused(workload, level)
        elif level != PRIVILEGED and list(broken(workload.pod, RESTRICTED)):
            unknown.add(workload.namespace)
    places = sorted({workload.namespace for workload in rendering.workloads})
    levels = [f"{place}: {level_of(place, rendering, namespaces) or 'no level'}" for place in places]
    unseen = f"the API server's own level counts in {named(sorted(unknown))}, and cannot be read" if unknown else ""
    return CheckVerdict(named(levels), problems, unseen)


def level_of(namespace: str, rendering: RenderedChart, namespaces: Labels) -> str:
    """The level that will be enforced: the chart's own label, else the one that stands; empty where there is none."""
    rendered = rendering.namespaces.get(namespace, {}).get(ENFORCE)
    return str(rendered or namespaces.get(namespace, {}).get(ENFORCE, ""))


def broken(pod: Pod, level: str) -> Iterator[tuple[str, str]]:
    """What of a pod the level refuses, each with the fix."""
    for rule in RULES:
        for sentence in rule.inspect(pod):
            if level == RESTRICTED or rule.name not in RESTRICTED_ALONE or _everywhere(sentence):
                yield sentence, rule.fix


def _everywhere(sentence: str) -> bool:
    """Return whether a sentence of a rule that is partly of `restricted` alone holds for `baseline` as well."""
    return HOST_FOLDER in sentence or "capabilities.add" in sentence


def _refused(workload: Workload, level: str) -> Iterator[Problem]:
    for sentence, fix in broken(workload.pod, level):
        why = f"namespace {workload.namespace} enforces {level}: the API server refuses the pod"
        relabel = f"kubectl label namespace {workload.namespace} {ENFORCE}={PRIVILEGED} --overwrite"
        yield Problem(sentence, workload.place, why, f"in the values: {fix}; or {relabel}")
