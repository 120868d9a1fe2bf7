"""What the policies would refuse of what a cluster runs now: asked before they are enforced."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.patterns import DIGEST
from robotkube.registry.admission.core.allowed import Allowed
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.charts.core.pod_images import pod_images

Object = Mapping[str, Any]
KINDS = {
    "/api/v1/pods": "Pod",
    "/api/v1/podtemplates": "PodTemplate",
    "/api/v1/replicationcontrollers": "ReplicationController",
    "/apis/apps/v1/daemonsets": "DaemonSet",
    "/apis/apps/v1/deployments": "Deployment",
    "/apis/apps/v1/replicasets": "ReplicaSet",
    "/apis/apps/v1/statefulsets": "StatefulSet",
    "/apis/batch/v1/cronjobs": "CronJob",
    "/apis/batch/v1/jobs": "Job",
}
"""Where the API lists what the policies judge in namespaces, and the kind, which items of lists do not say."""
APPLICATIONS = "/apis/argoproj.io/v1alpha1/applications"


@dataclass(frozen=True, order=True)
class Stranded:
    """An object that could not be made again, and why."""

    namespace: str
    kind: str
    name: str
    why: str

    def __str__(self) -> str:
        return f"{self.namespace}/{self.kind.lower()}/{self.name}: {self.why}"


def stranded(objects: Iterable[Object], domain: Domain, allowed: Allowed) -> tuple[Stranded, ...]:
    """Of pods, workloads and Applications those that would be refused if they were made now by who may make them."""
    refused = []
    for item in objects:
        metadata = item["metadata"]
        place = (str(metadata.get("namespace", "")), str(item["kind"]), str(metadata["name"]))
        reasons = (
            _application(item, domain, allowed) if item["kind"] == "Application" else _workload(item, domain, allowed)
        )
        refused += [Stranded(*place, why) for why in reasons]
    return tuple(sorted(refused))


def counted(objects: Sequence[Stranded], allowed: Allowed) -> str:
    """The verdict in one line."""
    counts = f"{len(allowed.charts)} charts, {len(allowed.verified)} images, {len(allowed.platform)} of the platform"
    verdict = f"{len(objects)} objects would be stranded" if objects else "nothing would be stranded"
    return f"{verdict} ({counts} listed)"


def _application(item: Object, domain: Domain, allowed: Allowed) -> Iterator[str]:
    source = item["spec"].get("source", {})
    address, revision = str(source.get("repoURL", "")), str(source.get("targetRevision", ""))
    chart = address.removeprefix(f"{domain.charts}/") if address.startswith(f"{domain.charts}/") else ""
    if f"{chart}@{revision}" not in allowed.charts:
        yield f"chart {address} at {revision or '(no digest)'} is not verified on the catalogue's main"
    namespace = item["spec"].get("destination", {}).get("namespace", "")
    if namespace not in domain.agents:
        yield f"namespace {namespace or '(none)'} is no agent's"


def _workload(item: Object, domain: Domain, allowed: Allowed) -> Iterator[str]:
    namespace = item["metadata"].get("namespace", "")
    if item.get("spec", {}).get("replicas") == 0 and item["kind"] == "ReplicaSet":
        return  # an earlier revision: nothing of it runs
    for reference in pod_images([item]):
        if not is_listed(reference, namespace, domain, allowed):
            yield f"image {reference or '(none)'} is not listed for this namespace"
    owners = item["metadata"].get("ownerReferences", [])
    closed = (*domain.agents, *domain.of_the_platform)
    if item["kind"] == "Pod" and namespace in closed and not any(owner.get("controller") for owner in owners):
        yield "no controller made this pod"


def is_listed(reference: str, namespace: str, domain: Domain, allowed: Allowed) -> bool:
    """Return whether an image may run in a namespace, by the policies' rules."""
    repository, _, digest = reference.partition("@")
    if not repository or not DIGEST.fullmatch(digest):
        return not (domain.elsewhere or namespace in (*domain.agents, *domain.tests, *domain.of_the_platform))
    if namespace in domain.tests:
        return True
    if namespace in domain.agents:
        return digest in allowed.verified
    if namespace in domain.of_the_platform:
        return digest in allowed.platform
    return not domain.elsewhere or digest in allowed.platform or digest in allowed.verified
