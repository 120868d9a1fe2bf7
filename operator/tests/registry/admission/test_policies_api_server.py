"""What a real API server lets in under the policies from files, and with which words it refuses everything else."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from robotkube.registry.admission.core.allowed import Allowed
from robotkube.registry.admission.core.lists import CHUNK
from robotkube.registry.admission.core.policies import for_files
from robotkube.registry.admission.core.stranded import stranded
from tests.stages.attacks import shown
from tests.stages.kubernetes.judged_api_server import ADMINISTRATOR, MERGE, Api, judged_api_server
from tests.stages.registry.admission_examples import (
    ALLOWED,
    APPLICATION_CONTROLLER,
    DEPLOYMENTS,
    DOMAIN,
    KINDS,
    OF_THE_PLATFORM,
    REPLICA_SETS,
    SERVER,
    STRANGE,
    SUITE_RUNNER,
    VERIFIED,
    digest,
    image,
    path,
    pod,
    pod_spec,
    workload,
)
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain]  # a server of the session
POLICIES = "/apis/admissionregistration.k8s.io/v1/validatingadmissionpolicies"
NAMESPACES = ("vehicle-00", "cloud-0", "robotkube-suite-0", "robotkube", "robotkube-gate", "argocd", "elsewhere")
MAKERS = {"vehicle-00": REPLICA_SETS, "robotkube-suite-0": SUITE_RUNNER, "robotkube": REPLICA_SETS}
OTHERS = {"vehicle-00": ADMINISTRATOR, "robotkube-suite-0": ADMINISTRATOR, "robotkube": ADMINISTRATOR}
DRY = "?dryRun=All"
TAGGED = "registry.example/robotkube/ros:1.0"


@pytest.fixture(scope="module")
def api(under_policies: Api) -> Api:
    for name in NAMESPACES:
        under_policies.request("POST", "/api/v1/namespaces", {"metadata": {"name": name}})
    return under_policies


def image_words(reference: str, namespace: str = "vehicle-00") -> str:
    return f"image {reference} may not run in namespace {namespace}: only images of chart versions that are verified"


def test_a_pod_of_verified_images_is_let_in(api: Api) -> None:
    volume = {"name": "model", "image": {"reference": VERIFIED}}
    whole = pod(VERIFIED, initContainers=[{"name": "first", "image": VERIFIED}], volumes=[volume])
    api.done("POST", path("Pod", "vehicle-00") + DRY, whole, REPLICA_SETS)


PARTS: dict[str, dict[str, Any]] = {
    "container": pod(STRANGE)["spec"],
    "second container": {"containers": [{"name": "a", "image": VERIFIED}, {"name": "b", "image": STRANGE}]},
    "init container": pod_spec(initContainers=[{"name": "first", "image": STRANGE}]),
    "sidecar": pod_spec(initContainers=[{"name": "side", "image": STRANGE, "restartPolicy": "Always"}]),
    "image volume": pod_spec(volumes=[{"name": "model", "image": {"reference": STRANGE}}]),
}


@pytest.mark.parametrize("part", PARTS)
def test_a_pod_with_an_image_that_is_not_listed_is_refused(api: Api, part: str) -> None:
    words = api.refusal("POST", path("Pod", "vehicle-00"), {**pod(), "spec": PARTS[part]}, REPLICA_SETS)
    assert words.startswith(image_words(STRANGE))
    if part == "image volume":
        shown("admission", words, "image-volume")
    else:
        shown("admission", words, "image-by-manager", "image-by-publisher", "merge-against-the-gate")
    assert words.endswith(
        "Submit the chart that needs it (robotkube registry submit), or name the digest that was verified"
    )


@pytest.mark.parametrize(
    "reference",
    [
        TAGGED,
        digest(1),  # a repository called sha256, with the digest as its tag
        f"{VERIFIED}@{digest(3)}",
        f"registry.example/a@{digest(3)}@{digest(1)}",
        f"registry.example/a@{digest(1).upper()}",
        f"registry.example/a@sha512:{'0' * 128}",
        f"@{digest(1)}",
        f"registry.example/a@{digest(1)[:-1]}",
    ],
)
def test_what_only_looks_like_a_listed_digest_is_none(api: Api, reference: str) -> None:
    words = api.refusal("POST", path("Pod", "vehicle-00"), pod(reference), REPLICA_SETS)
    assert words.startswith(f"image {reference} may not run")


def test_the_platforms_images_are_not_those_of_releases(api: Api) -> None:
    assert api.refusal("POST", path("Pod", "vehicle-00"), pod(OF_THE_PLATFORM), REPLICA_SETS).startswith(
        image_words(OF_THE_PLATFORM)
    )


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_workload_is_judged_by_its_template(api: Api, kind: str) -> None:
    maker = KINDS[kind][2]
    api.done("POST", path(kind, "vehicle-00") + DRY, workload(kind), maker)
    words = api.refusal("POST", path(kind, "vehicle-00"), workload(kind, STRANGE), maker)
    assert words.startswith(image_words(STRANGE))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("user", [ADMINISTRATOR, SERVER, "system:serviceaccount:vehicle-00:event-detector"])
def test_nobody_else_makes_workloads_of_an_agent(api: Api, kind: str, user: str) -> None:
    words = api.refusal("POST", path(kind, "vehicle-00"), workload(kind), user)
    assert words.startswith(f"{KINDS[kind][1]} made by {user or 'administrator'}: in an agent's namespace Argo CD's")
    assert words.endswith("Ask for it by a task (robotkube task submit), or propose a release")


@pytest.mark.parametrize("user", [ADMINISTRATOR, APPLICATION_CONTROLLER, DEPLOYMENTS, SUITE_RUNNER, "system:node:one"])
def test_nobody_but_controllers_makes_pods_of_an_agent(api: Api, user: str) -> None:
    words = api.refusal("POST", path("Pod", "vehicle-00"), pod(), user)
    assert words.startswith(f"pods made by {user or 'administrator'}: in an agent's namespace Argo CD's application")
    shown("admission", words, "pod-by-administrator")


def test_a_replica_set_of_its_own_is_not_argo_cds_to_make(api: Api) -> None:
    words = api.refusal("POST", path("ReplicaSet", "vehicle-00"), workload("ReplicaSet"), APPLICATION_CONTROLLER)
    assert words.startswith(f"replicasets made by {APPLICATION_CONTROLLER}: ")


@pytest.fixture
def deployment(api: Api) -> Iterator[str]:
    """The address of a release's Deployment."""
    api.done("POST", path("Deployment", "vehicle-00"), workload("Deployment"), APPLICATION_CONTROLLER)
    address = f"{path('Deployment', 'vehicle-00')}/detector"
    yield address
    api.done("DELETE", address)


def with_sidecar(reference: str) -> dict[str, Any]:
    containers = [{"name": "main", "image": VERIFIED}, {"name": "sidecar", "image": reference}]
    return {"spec": {"template": {"spec": {"containers": containers}}}}


CHANGES: dict[str, dict[str, Any]] = {
    "sidecar": with_sidecar(VERIFIED),
    "annotation": {"metadata": {"annotations": {"note": "mine"}}},
    "annotation of the pods": {"spec": {"template": {"metadata": {"annotations": {"note": "mine"}}}}},
    "label": {"metadata": {"labels": {"note": "mine"}}},
    "command": {
        "spec": {"template": {"spec": {"containers": [{"name": "main", "image": VERIFIED, "command": ["sh"]}]}}}
    },
}


@pytest.mark.parametrize("change", CHANGES)
def test_nobody_else_changes_a_workload_of_an_agent(api: Api, deployment: str, change: str) -> None:
    words = api.refusal("PATCH", deployment, CHANGES[change], kind=MERGE)
    assert words == (
        "deployments detector changed by administrator: in an agent's namespace nothing runs but what main says. "
        "Change the release on main"
    )
    if change in ("sidecar", "annotation"):
        shown("admission", words, "sidecar", "annotation")
    api.done("PATCH", deployment + DRY, CHANGES[change], APPLICATION_CONTROLLER, MERGE)


def test_an_update_to_an_image_that_is_not_listed_is_refused_to_argo_cd_too(api: Api, deployment: str) -> None:
    words = api.refusal("PATCH", deployment, with_sidecar(STRANGE), APPLICATION_CONTROLLER, MERGE)
    assert words.startswith(image_words(STRANGE))


def test_controllers_go_on_with_what_is_there(api: Api, deployment: str) -> None:
    revision = {"metadata": {"annotations": {"deployment.kubernetes.io/revision": "1"}}}
    api.done("PATCH", deployment, revision, DEPLOYMENTS, MERGE)
    api.done("PATCH", f"{deployment}/status", {"status": {"replicas": 1}}, DEPLOYMENTS, MERGE)
    api.done("PATCH", deployment + DRY, {"metadata": {"finalizers": ["example.org/wait"]}}, kind=MERGE)


@pytest.fixture
def running_pod(api: Api) -> Iterator[str]:
    api.done("POST", path("Pod", "vehicle-00"), pod(), REPLICA_SETS)
    address = f"{path('Pod', 'vehicle-00')}/pod"
    yield address
    api.done("DELETE", f"{address}?gracePeriodSeconds=0")


def ephemeral(reference: str) -> dict[str, Any]:
    return {"spec": {"ephemeralContainers": [{"name": "debug", "image": reference}]}}


def test_containers_are_not_added_to_pods_of_an_agent(api: Api, running_pod: str) -> None:
    place = f"{running_pod}/ephemeralcontainers"
    assert api.refusal("PATCH", place, ephemeral(STRANGE), kind=MERGE).startswith(image_words(STRANGE))
    words = api.refusal("PATCH", place, ephemeral(VERIFIED), kind=MERGE)
    assert words == (
        "no container may be added to a pod that runs in namespace vehicle-00: nobody verified the pod with it. "
        "Read the pod's logs, or try the chart with that container in a suite"
    )
    shown("admission", words, "ephemeral-container")


def test_the_image_of_a_pod_is_not_changed(api: Api, running_pod: str) -> None:
    change = {"spec": {"containers": [{"name": "main", "image": STRANGE}]}}
    assert api.refusal("PATCH", running_pod, change, REPLICA_SETS, MERGE).startswith(image_words(STRANGE))
    words = api.refusal("PATCH", running_pod, {"metadata": {"labels": {"app": "mine"}}}, kind=MERGE)
    assert words.startswith("pods pod changed by administrator: in an agent's namespace")


def test_a_test_namespace_takes_any_image_by_digest_from_the_suite_runner(api: Api) -> None:
    place = "robotkube-suite-0"
    for kind in ("Pod", "Deployment"):
        tried = pod(STRANGE) if kind == "Pod" else workload(kind, STRANGE)
        api.done("POST", path(kind, place) + DRY, tried, SUITE_RUNNER)
        assert api.refusal("POST", path(kind, place), tried).endswith(
            " made by administrator: in a test namespace the suite-runner alone starts what is tried. "
            "Submit the chart (robotkube registry submit)"
        )
    words = api.refusal("POST", path("Pod", place), pod(TAGGED), SUITE_RUNNER)
    assert words == (
        f"image {TAGGED} may not run in namespace {place}: a tag can be moved after it was checked, a digest cannot. "
        "Write <repository>@sha256:<digest> in the chart"
    )
    shown("admission", words, "tag-moves")


def test_containers_are_not_added_to_pods_under_test(api: Api) -> None:
    place = path("Pod", "robotkube-suite-0")
    api.done("POST", place, pod(STRANGE, "tried"), SUITE_RUNNER)
    words = api.refusal("PATCH", f"{place}/tried/ephemeralcontainers", ephemeral(STRANGE), kind=MERGE)
    assert words.startswith("no container may be added")
    api.done("DELETE", f"{place}/tried?gracePeriodSeconds=0")


@pytest.mark.parametrize("namespace", ["robotkube", "robotkube-gate", "argocd"])
def test_the_platform_runs_its_own_images(api: Api, namespace: str) -> None:
    api.done("POST", path("Deployment", namespace) + DRY, workload("Deployment", OF_THE_PLATFORM))
    api.done("POST", path("Pod", namespace) + DRY, pod(OF_THE_PLATFORM), REPLICA_SETS)
    words = f"image {{}} may not run in namespace {namespace}: only images that the platform was installed with"
    for reference in (VERIFIED, STRANGE):
        refused = api.refusal("POST", path("Deployment", namespace), workload("Deployment", reference))
        assert refused.startswith(words.format(reference))
        shown("admission", refused, "platform-image-pushed")
    assert api.refusal("POST", path("Pod", namespace), pod(OF_THE_PLATFORM)) == (
        "pod made by administrator: in the platform's namespaces controllers alone make pods. "
        "Change the values of the chart"
    )


def test_containers_added_to_the_platforms_pods_are_of_its_images(api: Api) -> None:
    place = path("Pod", "robotkube")
    api.done("POST", place, pod(OF_THE_PLATFORM), REPLICA_SETS)
    api.done("PATCH", f"{place}/pod/ephemeralcontainers{DRY}", ephemeral(OF_THE_PLATFORM), kind=MERGE)
    words = api.refusal("PATCH", f"{place}/pod/ephemeralcontainers", ephemeral(STRANGE), kind=MERGE)
    assert words.startswith(f"image {STRANGE} may not run in namespace robotkube")
    api.done("DELETE", f"{place}/pod?gracePeriodSeconds=0")


@pytest.mark.parametrize("namespace", ["elsewhere", "default", "kube-system"])
def test_other_namespaces_are_no_way_around(api: Api, namespace: str) -> None:
    for known in (VERIFIED, OF_THE_PLATFORM):
        api.done("POST", path("Pod", namespace) + DRY, pod(known))
    assert api.refusal("POST", path("Pod", namespace), pod(STRANGE)).startswith(
        f"image {STRANGE} may not run in namespace {namespace}: only images of the platform and of verified charts"
    )


def test_no_kind_of_the_api_makes_pods_unseen(api: Api) -> None:
    """Every kind in which the API server's own description has a pod's specification is judged."""
    definitions = api.client.get("/openapi/v2").json()["definitions"]
    holding = {"io.k8s.api.core.v1.PodSpec"}
    while more := {name for name, one in definitions.items() if name not in holding and holding & references(one)}:
        holding |= more
    kinds = [one for name in holding for one in definitions[name].get("x-kubernetes-group-version-kind", ())]
    assert {kind["kind"] for kind in kinds if not kind["kind"].endswith("List")} == {"Pod", *KINDS}


def references(value: Any) -> set[str]:
    """Definitions that a part of the description names."""
    if isinstance(value, dict):
        own = {str(value["$ref"]).rpartition("/")[2]} if "$ref" in value else set()
        return own.union(*map(references, value.values()))
    return set().union(*map(references, value)) if isinstance(value, list) else set()


def test_a_namespace_stays_what_it_is(api: Api) -> None:
    """Namespaces are matched by a label, which the API server keeps."""
    for labels in ({"kubernetes.io/metadata.name": "elsewhere"}, {"kubernetes.io/metadata.name": None}):
        api.request("PATCH", "/api/v1/namespaces/vehicle-00", {"metadata": {"labels": labels}}, kind=MERGE)
        assert api.refusal("POST", path("Pod", "vehicle-00"), pod()).startswith("pods made by administrator")
    named = {"metadata": {"name": "taken", "labels": {"kubernetes.io/metadata.name": "robotkube"}}}
    api.done("POST", "/api/v1/namespaces", named)
    assert api.refusal("POST", path("Pod", "taken"), pod(STRANGE)).startswith(
        f"image {STRANGE} may not run in namespace taken: only images of the platform and of verified charts"
    )


WAYS: dict[str, dict[str, Any]] = {
    "files": {"volumes": [{"name": "host", "hostPath": {"path": "/"}}]},
    "disks": {"volumes": [{"name": "disk", "fc": {"wwids": ["3600508b400105e210000900000490000"]}}]},
    "network": {"hostNetwork": True},
    "processes": {"hostPID": True},
    "memory": {"hostIPC": True},
    "privileges": {"containers": [{"name": "main", "image": VERIFIED, "securityContext": {"privileged": True}}]},
    "a capability": {
        "containers": [{"name": "main", "image": VERIFIED, "securityContext": {"capabilities": {"add": ["SYS_ADMIN"]}}}]
    },
    "first privileges": {
        "initContainers": [{"name": "first", "image": VERIFIED, "securityContext": {"privileged": True}}]
    },
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("namespace", ["vehicle-00", "default"])
def test_no_pod_gets_a_way_to_its_machine(api: Api, namespace: str, way: str) -> None:
    """The policies themselves are files of a machine."""
    words = api.refusal("POST", path("Pod", namespace), {**pod(), "spec": pod_spec(**WAYS[way])}, REPLICA_SETS)
    assert words.startswith(f"pods in namespace {namespace} ask for a way to their machine")
    shown("admission", words, "way-to-the-machine", "application-to-the-machine")


def test_a_policy_in_files_can_be_neither_seen_nor_deleted(api: Api) -> None:
    assert api.done("GET", POLICIES)["items"] == []
    gone = api.request("DELETE", f"{POLICIES}/robotkube-agents.static.k8s.io")
    assert (gone["reason"], gone["status"]) == ("NotFound", "Failure")
    shown("admission", gone["message"], "policy-deleted")
    api.done("DELETE", POLICIES)
    assert api.refusal("POST", path("Pod", "vehicle-00"), pod(STRANGE), REPLICA_SETS)


def test_no_object_takes_the_name_of_a_policy_in_files(api: Api) -> None:
    [policy, *_] = for_files(DOMAIN, ALLOWED)
    answer = api.request("POST", POLICIES, policy)
    assert (answer["status"], answer["reason"]) == ("Failure", "Invalid")


def test_what_would_be_stranded_is_what_the_policies_refuse(api: Api) -> None:
    """The answer before admission is enforced, and that of the API server."""
    images = (VERIFIED, OF_THE_PLATFORM, STRANGE, TAGGED)
    for namespace in NAMESPACES:
        maker = SUITE_RUNNER if namespace == "robotkube-suite-0" else APPLICATION_CONTROLLER
        for reference in images:
            made = workload("Deployment", reference)
            answer = api.request("POST", path("Deployment", namespace) + DRY, made, maker)
            foretold = stranded([{**made, "metadata": {"name": "a", "namespace": namespace}}], DOMAIN, ALLOWED)
            assert (answer.get("status") == "Failure") == bool(foretold), (namespace, reference, answer)


def test_a_long_list_is_asked_in_parts_and_a_changed_file_is_at_work_by_itself(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """A list that still fits into the policy's condition, and one that does not."""
    with judged_api_server(tmp_path_factory.mktemp("long"), for_files(DOMAIN, ALLOWED)) as (server, files):
        server.done("POST", "/api/v1/namespaces", {"metadata": {"name": "vehicle-00"}})
        place = path("Pod", "vehicle-00") + DRY
        server.done("POST", place, pod(), REPLICA_SETS)
        for count in (CHUNK, 2 * CHUNK + 500):
            numbers = range(100, 100 + count)
            assert files.write(for_files(DOMAIN, Allowed(tuple(map(digest, numbers)), (digest(2),), ())))
            last = pod(image(numbers[-1]))
            until(lambda: server.request("POST", place, last, REPLICA_SETS)["kind"] == "Pod")  # noqa: B023
            for number in {numbers[0], *numbers[CHUNK - 1 :: CHUNK], *numbers[CHUNK::CHUNK]}:
                server.done("POST", place, pod(image(number)), REPLICA_SETS)
            assert server.refusal("POST", place, pod(), REPLICA_SETS).startswith(image_words(VERIFIED))
