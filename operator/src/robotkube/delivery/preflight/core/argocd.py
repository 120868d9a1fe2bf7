"""Argo CD: whether it is there, in which version, and whether it runs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem
from robotkube.delivery.preflight.core.renderings import Object, labels_of, name_of
from robotkube.registry.suites.core.pod_security import items, mapping

DEFINITIONS = tuple(f"{name}.argoproj.io" for name in ("applications", "applicationsets", "appprojects"))
COMPONENT = "app.kubernetes.io/component"
PARTS = ("application-controller", "applicationset-controller", "repo-server", "server")
IMAGE_TAG = re.compile(r"[^@]*:(v?[0-9]+\.[0-9]+[^/@]*)(@.*)?")
VERSION_LABEL = "app.kubernetes.io/version"
VERSION = re.compile(r"v?([0-9]+)\.([0-9]+).*")
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
    own = [parts[part] for part in PARTS if part in parts]
    tagged, labelled = _version(_tags(own)), _version(str(labels_of(one).get(VERSION_LABEL, "")) for one in own)
    version = tagged or labelled
    unseen = "" if version or problems else f"neither a tag of its images nor a label {VERSION_LABEL} says its version"
    if version and not version.startswith(f"{MAJOR}."):
        unseen = f"the platform is tested with Argo CD {MAJOR} alone, which does not say what {version} does"
    known = f"{version or 'not known'}{f' (label {VERSION_LABEL})' if version and not tagged else ''}"
    return CheckVerdict(f"version {known} in namespace {present.namespace}", problems, unseen)


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


def _tags(workloads: Sequence[Object]) -> Iterator[str]:
    """The tags of the workloads' images."""
    for workload in workloads:
        template = mapping(mapping(workload.get("spec")).get("template"))
        for container in items(mapping(template.get("spec")).get("containers")):
            match = IMAGE_TAG.fullmatch(str(container.get("image", "")))
            yield match[1] if match else ""


def _version(texts: Iterable[str]) -> str:
    """The first two numbers of the first text that is a version; empty when none is."""
    match = next(filter(None, map(VERSION.fullmatch, texts)), None)
    return f"{match[1]}.{match[2]}" if match else ""
