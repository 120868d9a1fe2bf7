"""Policy for subresources of pods and workloads: labels, annotations and limits that come by another address.

Kubelets, the scheduler and most controllers write status without a change of labels or annotations. The deployment
controller writes its revision, an annotation, with the status of a Deployment. Where others made the cluster, some
networks write theirs with the status of a pod, and no pod would start without.
"""

from __future__ import annotations

from robotkube.registry.admission.core.documents import Place, Policy, Validation
from robotkube.registry.admission.core.domain import KEEPERS, Domain, controllers
from robotkube.registry.admission.core.expressions import (
    CREATING,
    RESOURCE,
    RESOURCES,
    WRITER,
    changed,
    one_of,
    sentence,
)
from robotkube.registry.admission.core.lists import texts

BINDINGS = "bindings"
STATUS = tuple((group, tuple(f"{kind}/status" for kind in kinds if "/" not in kind)) for group, kinds in RESOURCES)
OTHERS = ("", ("pods/resize", "pods/binding", BINDINGS))
WORDS = ("metadata.labels", "metadata.annotations")
OF_NETWORKS = ("cni.projectcalico.org/", "k8s.ovn.org/", "k8s.v1.cni.cncf.io/network-status")  # Calico, OVN, Multus
TOPOLOGY = "topology.kubernetes.io/"  # of the pod's node, by the API server itself
PART = "request.?subResource.orValue('')"
CHANGE = "Change the release on main"


def policy(domain: Domain) -> Policy:
    """Of the agents' and the test namespaces, whose workloads nobody changes otherwise either."""
    place = Place((*domain.agents, *domain.tests))
    rules = [_resize(), _binding(), _status(networks=not domain.elsewhere)]
    return Policy("robotkube-subresources", _kinds(), place, [], rules)


def _kinds() -> list[tuple[str, tuple[str, ...]]]:
    core, *others = STATUS
    return [(core[0], (*core[1], *OTHERS[1])), *others]


def _resize() -> Validation:
    why = f": in its namespace a container has what its chart asks for. {CHANGE}"
    return Validation(f"{PART} != 'resize'", sentence("pod ", "request.name", " resized by ", WRITER, why))


def _binding() -> Validation:
    """What a binding has of both becomes the pod's."""
    labels = f"object.metadata.?labels.orValue({{}}).all(k, k.startsWith('{TOPOLOGY}'))"
    plain = f"{labels} && object.metadata.?annotations.orValue({{}}).size() == 0"
    why = " would give the pod labels or annotations that its chart does not have. Bind it without"
    return Validation(
        f"!({RESOURCE} == '{BINDINGS}' || {PART} == 'binding') || {plain}",
        sentence("binding of a pod by ", WRITER, why),
    )


def _status(networks: bool) -> Validation:
    """The rule for the status of pods. `networks`: annotations of pods that are a network's may change."""
    ways = [f"{PART} != 'status'", CREATING, one_of(controllers(*KEEPERS)), f"!({changed(WORDS)})"]
    if networks:
        ways.append(f"{RESOURCE} == 'pods' && {_of_networks()}")
    by = " changed with its status by "
    why = f": in its namespace labels and annotations are those that main says. {CHANGE}"
    says = sentence("labels or annotations of ", RESOURCE, " ", "request.name", by, WRITER, why)
    return Validation(" || ".join(ways), says)


def _of_networks() -> str:
    now, before = (f"{whole}.metadata.?annotations.orValue({{}})" for whole in ("object", "oldObject"))
    known = f"{texts(OF_NETWORKS)}.exists(n, k.startsWith(n))"
    came = f"{now}.all(k, {known} || k in {before} && {before}[k] == {now}[k])"
    went = f"{before}.all(k, {known} || k in {now})"
    return f"!({changed(WORDS[:1])}) && {came} && {went}"
