"""Owners: what stands in the cluster under the names of the chart's objects, and whether Helm has it as this release's.

Looked at are the objects of the whole cluster: definitions, namespaces, ClusterRoles and their bindings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem
from robotkube.delivery.preflight.core.renderings import (
    OF_THE_CLUSTER,
    Object,
    RenderedChart,
    annotations_of,
    labels_of,
    name_of,
)

MANAGED_BY = "app.kubernetes.io/managed-by"
RELEASE_NAME, RELEASE_NAMESPACE = "meta.helm.sh/release-name", "meta.helm.sh/release-namespace"
Standing = Mapping[tuple[str, str], Object | None]
"""What stands under kind and name; None where there is nothing."""


def owned_objects(rendering: RenderedChart) -> tuple[Object, ...]:
    """The objects of the chart whose owners are looked at."""
    return tuple(rendering.of_kind(*OF_THE_CLUSTER))


def owners(rendering: RenderedChart, standing: Standing, namespaces: Mapping[str, Mapping[str, str]]) -> CheckVerdict:
    """What is there already is this release's, and the release's own namespace is there."""
    problems = [*_no_namespace(rendering, namespaces)]
    for (kind, name), item in standing.items():
        if item is not None:
            problems += _foreign(kind, name, item, rendering)
    there = sum(item is not None for item in standing.values())
    return CheckVerdict(f"{there} of {len(standing)} objects of the whole cluster are there already", problems)


def _no_namespace(rendering: RenderedChart, namespaces: Mapping[str, Mapping[str, str]]) -> Iterator[Problem]:
    own = rendering.namespace
    if own not in namespaces:
        fix = f"kubectl create namespace {own}, and label it pod-security.kubernetes.io/enforce=restricted"
        yield Problem(
            f"there is no namespace {own}", f"Namespace {own}", "Helm installs into a namespace that is there", fix
        )


def _foreign(kind: str, name: str, item: Object, rendering: RenderedChart) -> Iterator[Problem]:
    said = annotations_of(item)
    owner = f"{said.get(RELEASE_NAMESPACE, '')}/{said.get(RELEASE_NAME, '')}"
    own = f"{rendering.namespace}/{rendering.release}"
    if owner == own and labels_of(item).get(MANAGED_BY) == "Helm":
        return
    whose = f"of release {owner}" if owner != "/" else "of no Helm release"
    why = "Helm refuses to take over an object that is not its release's"
    adopt = (
        f"kubectl label {kind.lower()} {name} {MANAGED_BY}=Helm --overwrite; kubectl annotate {kind.lower()} {name} "
        f"{RELEASE_NAME}={rendering.release} {RELEASE_NAMESPACE}={rendering.namespace} --overwrite"
    )
    other = "rename the agent in the values, or " if kind == "Namespace" else ""
    fix = f"{other}when it is left over and yours, let Helm take it: {adopt}; else remove it"
    yield Problem(f"it is there already, {whose}", f"{kind} {name_of(item) or name}", why, fix)
