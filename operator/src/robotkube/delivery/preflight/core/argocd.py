"""Argo CD: whether it is there, in which version, and whether it runs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem
from robotkube.delivery.preflight.core.renderings import Object, labels_of, name_of
from robotkube.registry.suites.core.pod_security import items, mapping

DEFINITIONS = tuple(f"{name}.argoproj.io" for name in ("applications", "applicationsets", "appprojects"))
COMPONENT = "app.kubernetes.io/component"
PARTS = ("application-controller", "applicationset-controller", "repo-server", "server")
IMAGE_TAG = re.compile(r"[^@]*:v?([0-9]+)\.([0-9]+)[^/@]*(@.*)?")
MAJOR = 3  # the one that the platform is tested with


@dataclass(frozen=True)
class ArgoCd:
    """What is there of Argo CD: names of its definitions, and its Deployments and StatefulSets."""

    namespace: str
    definitions: frozenset[str]
    workloads: Sequence[Object]


def argocd(present: ArgoCd) -> CheckVerdict:
    """It has its definitions, and the parts that carry releases out are running."""
    problems = [_undefined(name) for name in DEFINITIONS if name not in present.definitions]
    parts = {str(labels_of(one).get(COMPONENT, "")): one for one in present.workloads}
    for part in PARTS:
        problems += _part(part, parts.get(part), present.namespace)
    version = _version(present.workloads)
    unseen = "" if version or problems else "its images have no tag, so its version is not known"
    if version and not version.startswith(f"{MAJOR}."):
        unseen = f"the platform is tested with Argo CD {MAJOR} alone, which does not say what {version} does"
    return CheckVerdict(f"version {version or 'not known'} in namespace {present.namespace}", problems, unseen)


def namespace_in(settings: Mapping[str, Any]) -> str:
    """Where the values say that Argo CD is."""
    return str(mapping(settings.get("argocd")).get("namespace") or "argocd")


def _undefined(name: str) -> Problem:
    why = "the chart makes such objects, and Helm refuses them"
    return Problem(
        f"there is no definition {name}", f"CustomResourceDefinition {name}", why, "install Argo CD before the platform"
    )


def _part(part: str, workload: Object | None, namespace: str) -> Iterator[Problem]:
    where = f"namespace {namespace}, {COMPONENT}={part}"
    why = "releases on main are not brought to the agents, and the Job bootstrap waits for it"
    if workload is None:
        fix = "install Argo CD there, or name its namespace in argocd.namespace"
        yield Problem(f"no Deployment or StatefulSet of {part}", where, why, fix)
    elif not mapping(workload.get("status")).get("readyReplicas"):
        fix = f"kubectl --namespace {namespace} get pods; kubectl describe says why one is not ready"
        yield Problem(f"no pod of {name_of(workload)} is ready", where, why, fix)


def _version(workloads: Sequence[Object]) -> str:
    for workload in workloads:
        template = mapping(mapping(workload.get("spec")).get("template"))
        for container in items(mapping(template.get("spec")).get("containers")):
            match = IMAGE_TAG.fullmatch(str(container.get("image", "")))
            if match and labels_of(workload).get(COMPONENT) in PARTS:
                return f"{match[1]}.{match[2]}"
    return ""
