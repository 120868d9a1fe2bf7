"""Kubernetes' own controllers under the policies: what main says becomes pods, changes, and goes again, and nothing of
it is refused. Pods wait for a node, which is not here."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from robotkube.registry.admission.core.policies import for_files
from tests.stages.kubernetes.controllers import controlling
from tests.stages.kubernetes.judged_api_server import MERGE, Api, judged_api_server
from tests.stages.registry.admission_examples import (
    ALLOWED,
    APPLICATION_CONTROLLER,
    DOMAIN,
    KINDS,
    STRANGE,
    SUITE_RUNNER,
    VERIFIED,
    image,
    path,
    workload,
)
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain]
AGENT, TESTS = "vehicle-00", "robotkube-suite-0"
MAKING_PODS = ("Deployment", "StatefulSet", "ReplicationController")  # at once, without a node or an hour


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """The API server with its controller manager, as the embedded cluster starts it."""
    with judged_api_server(tmp_path_factory.mktemp("api"), for_files(DOMAIN, ALLOWED)) as (api, _):
        for name in (AGENT, TESTS):
            api.done("POST", "/api/v1/namespaces", {"metadata": {"name": name}})
        with controlling(api.server.folder, api.server.kubeconfig):
            yield api


def running(api: Api, namespace: str, reference: str) -> list[dict[str, Any]]:
    """Pods with this image that are not on their way out."""
    items = api.done("GET", path("Pod", namespace))["items"]
    return [
        item
        for item in items
        if item["spec"]["containers"][0]["image"] == reference and "deletionTimestamp" not in item["metadata"]
    ]


@pytest.mark.parametrize("kind", MAKING_PODS)
@pytest.mark.parametrize(("namespace", "writer"), [(AGENT, APPLICATION_CONTROLLER), (TESTS, SUITE_RUNNER)])
def test_a_workload_gets_its_pod_and_its_new_one_and_loses_both(
    api: Api, kind: str, namespace: str, writer: str
) -> None:
    place = path(kind, namespace)
    name = f"a-{kind.lower()}"
    made = workload(kind, VERIFIED, name)
    api.done("POST", place, made, writer)
    until(lambda: running(api, namespace, VERIFIED), f"a pod of {kind}")
    if kind == "Deployment":
        newer = {"spec": {"template": {"spec": {"containers": [{"name": "main", "image": image(11)}]}}}}
        api.done("PATCH", f"{place}/{name}", newer, writer, MERGE)
        until(lambda: running(api, namespace, image(11)), "a pod of the new image")
    api.done("DELETE", f"{place}/{name}", {"propagationPolicy": "Foreground"})
    gone = [*([path("ReplicaSet", namespace)] if kind == "Deployment" else []), path("Pod", namespace), place]
    for where in gone:
        until(lambda where=where: not api.done("GET", where)["items"], f"{where} empty")


def test_a_job_gets_its_pod(api: Api) -> None:
    made = workload("Job")
    assert "jobs made by administrator" in api.refusal("POST", path("Job", AGENT), made)
    api.done("POST", path("Job", AGENT), made, APPLICATION_CONTROLLER)
    until(lambda: running(api, AGENT, VERIFIED), "the job's pod")
    api.done("DELETE", f"{path('Job', AGENT)}/detector", {"propagationPolicy": "Background"})
    until(lambda: not api.done("GET", path("Pod", AGENT))["items"], "no pod")


def test_a_replica_set_that_is_not_argo_cds_makes_no_pod_of_a_strange_image(api: Api) -> None:
    """Somebody who got past the rules on who makes what, by a controller's account."""
    words = api.refusal("POST", path("ReplicaSet", AGENT), workload("ReplicaSet", STRANGE), KINDS["ReplicaSet"][2])
    assert words.startswith(f"image {STRANGE} may not run in namespace {AGENT}")


def test_a_namespace_goes_with_what_is_in_it(api: Api) -> None:
    api.done("POST", path("Deployment", AGENT), workload("Deployment"), APPLICATION_CONTROLLER)
    until(lambda: running(api, AGENT, VERIFIED), "a pod")
    api.request("DELETE", f"/api/v1/namespaces/{AGENT}")
    until(lambda: api.request("GET", f"/api/v1/namespaces/{AGENT}")["kind"] == "Status", "the namespace gone", 60)
