"""What a real API server lets into pods and workloads by their subresources, under the policies from files and under
the same as objects."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from robotkube.registry.admission.core.domain import Domain, account
from robotkube.registry.admission.core.list_objects import documents_for_api
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.admission.core.policies import for_files, platform_entries
from tests.stages.attacks import shown
from tests.stages.kubernetes.judged_api_server import ADMINISTRATOR, MERGE, Api, judged_api_server
from tests.stages.registry.admission_examples import (
    ALLOWED,
    APPLICATION_CONTROLLER,
    CHARTS,
    DEPLOYMENTS,
    DOMAIN,
    KINDS,
    REPLICA_SETS,
    SUITE_RUNNER,
    VERIFIED,
    path,
    pod,
    workload,
)
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain]
AGENT, TESTS, PLATFORM = "vehicle-00", "robotkube-suite-0", "robotkube"
NAMESPACES = (AGENT, TESTS, PLATFORM)
NODE = "system:node:one"
STATUS_KINDS = sorted(set(KINDS) - {"PodTemplate"})  # it has none
ANNOTATED = {"metadata": {"annotations": {"a": "b"}}}
LABELLED = {"metadata": {"labels": {"app": "other"}}}
OF_A_NETWORK = {"metadata": {"annotations": {"cni.projectcalico.org/podIP": "10.0.0.1/32"}}}
GROUP = "/apis/admissionregistration.k8s.io/v1"
PLACES = {
    "ValidatingAdmissionPolicy": f"{GROUP}/validatingadmissionpolicies",
    "ValidatingAdmissionPolicyBinding": f"{GROUP}/validatingadmissionpolicybindings",
    "ConfigMap": "/api/v1/namespaces/robotkube/configmaps",
}


def put_objects(api: Api) -> None:
    """As `robotkube-admission` and Helm put them on clusters of others."""
    listed = AllowedVersions(ALLOWED.charts, ALLOWED.verified)
    platform = {"kind": "ConfigMap", "metadata": {"name": "admission-platform"}}
    domain = Domain((AGENT,), (TESTS,), CHARTS)
    for item in ({**platform, "data": platform_entries(ALLOWED.platform)}, *documents_for_api(domain, listed)):
        api.done("POST", PLACES[item["kind"]], item)
    until(lambda: api.request("POST", path("Pod", AGENT) + "?dryRun=All", pod(name="asked"))["kind"] == "Status")


@pytest.fixture(scope="module", params=["files", "objects"])
def api(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Iterator[Api]:
    """With a pod and a workload of each kind in an agent's namespace, and a pod in the others."""
    documents = for_files(DOMAIN, ALLOWED) if request.param == "files" else None
    with judged_api_server(tmp_path_factory.mktemp("api"), documents) as (api, _):
        for name in NAMESPACES:
            api.done("POST", "/api/v1/namespaces", {"metadata": {"name": name}})
        if documents is None:
            put_objects(api)
        for kind in STATUS_KINDS:
            api.done("POST", path(kind, AGENT), workload(kind), KINDS[kind][2])
        api.done("POST", "/api/v1/nodes", {"metadata": {"name": "one"}, "status": {"allocatable": {"cpu": "4"}}})
        containers = [{"name": "main", "image": VERIFIED, "resources": {"requests": {"cpu": "100m"}}}]
        for namespace, maker in ((AGENT, REPLICA_SETS), (TESTS, SUITE_RUNNER)):
            api.done("POST", path("Pod", namespace), pod(containers=containers), maker)
        api.done("POST", f"{path('Pod', AGENT)}/pod/binding", binding(), "system:kube-scheduler")
        asked = (f"{status('Deployment')}?dryRun=All", ANNOTATED, ADMINISTRATOR, MERGE)
        until(lambda: api.request("PATCH", *asked)["kind"] == "Status", "this policy counts: each begins by itself")
        yield api


def binding(**metadata: Any) -> dict[str, Any]:
    """As the scheduler sends it."""
    target = {"kind": "Node", "name": "one"}
    return {"kind": "Binding", "apiVersion": "v1", "metadata": {"name": "pod", **metadata}, "target": target}


def status(kind: str, namespace: str = AGENT) -> str:
    return f"{path(kind, namespace)}/{'pod' if kind == 'Pod' else 'detector'}/status"


@pytest.mark.parametrize("user", [ADMINISTRATOR, APPLICATION_CONTROLLER, account(AGENT, "event-detector")])
@pytest.mark.parametrize("kind", ["Pod", *STATUS_KINDS])
def test_no_annotation_comes_with_a_status(api: Api, kind: str, user: str) -> None:
    words = api.refusal("PATCH", status(kind), ANNOTATED, user, MERGE)
    resource = "pods" if kind == "Pod" else KINDS[kind][1]
    name = "pod" if kind == "Pod" else "detector"
    assert words == (
        f"labels or annotations of {resource} {name} changed with its status by {user or 'administrator'}: in its "
        "namespace labels and annotations are those that main says. Change the release on main"
    )
    shown("admission", words, "annotation-by-status")


@pytest.mark.parametrize("namespace", [AGENT, TESTS])
@pytest.mark.parametrize("change", [LABELLED, {"metadata": {"labels": None}}])
def test_no_label_of_a_pod_comes_or_goes_with_its_status(api: Api, namespace: str, change: dict[str, Any]) -> None:
    words = api.refusal("PATCH", status("Pod", namespace), change, kind=MERGE)
    assert words.startswith("labels or annotations of pods pod changed with its status by administrator")


def test_a_status_itself_is_anybodys_who_may_write_it(api: Api) -> None:
    """Of kubelets, the scheduler and controllers: none of theirs has labels or annotations."""
    ready = {"status": {"conditions": [{"type": "Ready", "status": "True"}], "phase": "Running"}}
    for user in (NODE, "system:kube-scheduler", account("kube-system", "node-controller"), ADMINISTRATOR):
        api.done("PATCH", status("Pod"), ready, user, MERGE)
    for kind in STATUS_KINDS:
        now = api.done("GET", status(kind))
        api.done("PUT", status(kind), now)


def test_the_deployment_controller_writes_its_revision(api: Api) -> None:
    revision = {"metadata": {"annotations": {"deployment.kubernetes.io/revision": "2"}}}
    made = api.done("PATCH", status("Deployment"), revision, DEPLOYMENTS, MERGE)
    assert made["metadata"]["annotations"] == revision["metadata"]["annotations"]


@pytest.mark.parametrize("namespace", [AGENT, TESTS])
def test_no_pod_is_resized(api: Api, namespace: str) -> None:
    more = {"spec": {"containers": [{"name": "main", "resources": {"requests": {"cpu": "2"}}}]}}
    words = api.refusal(
        "PATCH", f"{path('Pod', namespace)}/pod/resize", more, kind="application/strategic-merge-patch+json"
    )
    assert words.startswith("pod pod resized by administrator: in its namespace a container has what its chart asks")
    shown("admission", words, "pod-resized")


@pytest.mark.parametrize("place", ["pods/pod/binding", "bindings"])
@pytest.mark.parametrize("metadata", [ANNOTATED["metadata"], LABELLED["metadata"]])
def test_a_binding_brings_nothing_to_its_pod(api: Api, place: str, metadata: dict[str, Any]) -> None:
    whole = f"/api/v1/namespaces/{TESTS}/{place}"
    words = api.refusal("POST", whole, binding(**metadata))
    assert words.startswith("binding of a pod by administrator would give the pod labels or annotations")
    labels = {"topology.kubernetes.io/zone": "a"}
    api.done("POST", f"{whole}?dryRun=All", binding(labels=labels), "system:kube-scheduler")


def test_a_network_of_others_writes_its_own_annotations(api: Api, request: pytest.FixtureRequest) -> None:
    """Calico's plugin does before a pod starts. The embedded cluster has a network of its own, which writes none."""
    ours = "[files]" in request.node.name
    if ours:
        assert api.refusal("PATCH", status("Pod"), OF_A_NETWORK, NODE, MERGE)
        return
    api.done("PATCH", status("Pod"), OF_A_NETWORK, "system:serviceaccount:calico-system:calico-cni-plugin", MERGE)
    both = {"metadata": {"annotations": {**OF_A_NETWORK["metadata"]["annotations"], "a": "b"}}}
    assert api.refusal("PATCH", status("Pod"), both, kind=MERGE)
    relabelled = {"metadata": {**OF_A_NETWORK["metadata"], **LABELLED["metadata"]}}
    assert api.refusal("PATCH", status("Pod"), relabelled, kind=MERGE)
    gone = {"metadata": {"annotations": {"cni.projectcalico.org/podIP": None}}}
    api.done("PATCH", status("Pod"), gone, kind=MERGE)
