"""The platform chart's admission policies: those of the embedded cluster's files, as objects that an administrator can
delete."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from ci.cluster import admission
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.core.policies import LIST, for_api, list_entries, platform_entries
from tests.charts.conftest import PLATFORM, PROFILES, Helm, Rendered
from tests.stages.kubernetes.judged_api_server import Api, judged_api_server
from tests.stages.registry.admission_examples import (
    APPLICATION_CONTROLLER,
    APPLICATIONS,
    GENERATOR,
    REPLICA_SETS,
    STRANGE,
    VERIFIED,
    application,
    digest,
    path,
    pod,
    workload,
)
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain
FILES = (PLATFORM / "values-embedded.yaml", PROFILES / "embedded.yaml")
POLICIES = "/apis/admissionregistration.k8s.io/v1"
DRY = "?dryRun=All"


@pytest.fixture(scope="module")
def rendered(helm: Helm) -> Rendered:
    return helm.template(PLATFORM, *FILES, admission={"enabled": True})


def domain(embedded: Rendered, remover: str = "") -> Domain:
    namespaces = [item["metadata"] for item in embedded.of_kind("Namespace")]
    agents = [item["name"] for item in namespaces if "robotkube.io/agent" in item["labels"]]
    tests = [item["name"] for item in namespaces if item["name"].startswith("robotkube-suite-")]
    return Domain(tuple(agents), tuple(tests), admission.CHARTS, remover=remover)


def policies(rendered: Rendered) -> list[dict[str, Any]]:
    return [item for item in rendered.objects if item["apiVersion"].startswith("admissionregistration.k8s.io/")]


def test_without_the_value_there_are_none(embedded: Rendered) -> None:
    assert policies(embedded) == []
    assert not [item for item in embedded.of_kind("ConfigMap") if item["metadata"]["name"].startswith("admission")]


def test_they_are_what_the_code_makes_for_this_installation(rendered: Rendered) -> None:
    """The same rules as in the embedded cluster's files, but for where the list stands."""
    found = policies(rendered)
    assert {item["metadata"].pop("labels")["app.kubernetes.io/component"] for item in found} == {"admission"}
    made = for_api(domain(rendered))
    assert by_name(found) == by_name(made)


def test_the_remover_is_named_where_it_is_enabled(helm: Helm) -> None:
    """Where it is not, nobody but Argo CD changes a workload."""
    found = helm.template(PLATFORM, *FILES, admission={"enabled": True}, remover={"enabled": True})
    made = policies(found)
    for item in made:
        item["metadata"].pop("labels")
    assert by_name(made) == by_name(for_api(domain(found, "remover")))
    assert "system:serviceaccount:robotkube:remover" in str(made)


def by_name(documents: list[dict[str, Any]]) -> dict[tuple[str, str], dict[str, Any]]:
    return {(item["kind"], item["metadata"]["name"]): item for item in documents}


def test_the_embedded_cluster_knows_where_the_chart_has_charts(embedded: Rendered) -> None:
    [project] = embedded.of_kind("AppProject")
    assert project["spec"]["sourceRepos"] == [f"{admission.CHARTS}/*"]


def test_the_platforms_images_are_listed_by_the_chart(rendered: Rendered) -> None:
    listed = rendered.one("ConfigMap", "admission-platform")["data"]
    images = {c["image"] for _, spec in rendered.pods for c in [*spec["containers"], *spec.get("initContainers", [])]}
    assert set(platform_entries(image.partition("@")[2] for image in images)) <= set(listed)


def test_without_agents_and_suites_their_policies_are_missing(helm: Helm) -> None:
    found = helm.template(PLATFORM, *FILES, admission={"enabled": True}, agents=[], suites={"enabled": False})
    names = {item["metadata"]["name"] for item in policies(found)}
    assert names == {"robotkube-platform", "robotkube-applications", "robotkube-projects"}


def test_an_image_by_tag_is_refused_with_the_fix(helm: Helm) -> None:
    said = helm.refusal(PLATFORM, PROFILES / "official.yaml", admission={"enabled": True})
    assert 'admission.enabled is true, but images.gitea is "docker.io/gitea/gitea:' in said
    assert "Give <repository>@sha256:<digest>, or set admission.enabled: false." in said


@pytest.fixture(scope="module")
def api(rendered: Rendered, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """An API server with the rendered policies, after they have come to work."""
    with judged_api_server(tmp_path_factory.mktemp("api"), None) as (api, _):
        for name in ("robotkube", "argocd", "vehicle-00", "elsewhere"):
            api.done("POST", "/api/v1/namespaces", {"metadata": {"name": name}})
        for item in (*policies(rendered), rendered.one("ConfigMap", "admission-platform")):
            kind = {"ValidatingAdmissionPolicy": "validatingadmissionpolicies"}.get(
                item["kind"], "validatingadmissionpolicybindings"
            )
            place = "/api/v1/namespaces/robotkube/configmaps" if item["kind"] == "ConfigMap" else f"{POLICIES}/{kind}"
            api.done("POST", place, item)
        until(lambda: "denied request" in str(api.request("POST", APPLICATIONS + DRY, application(), GENERATOR)))
        yield api


def test_nothing_starts_before_the_list_is_there_and_what_it_has_afterwards(api: Api, rendered: Rendered) -> None:
    pods, applied = path("Pod", "vehicle-00") + DRY, application()
    applied["spec"]["destination"]["namespace"] = "vehicle-00"
    until(lambda: "no params found" in str(api.request("POST", pods, pod(), REPLICA_SETS)))
    made = {"apiVersion": "v1", "kind": "ConfigMap", "metadata": {"name": LIST}}
    listed = list_entries((f"event-detector@{digest(9)}",), (digest(1),))
    api.done("POST", "/api/v1/namespaces/robotkube/configmaps", {**made, "data": listed})
    until(lambda: api.request("POST", pods, pod(), REPLICA_SETS)["kind"] == "Pod")
    api.done("POST", path("Deployment", "vehicle-00") + DRY, workload("Deployment"), APPLICATION_CONTROLLER)
    until(lambda: api.request("POST", APPLICATIONS + DRY, applied, GENERATOR)["kind"] == "Application")
    for reference in (STRANGE, "ros:1.0", digest(1), f"{VERIFIED}@{digest(3)}", f"a@image.{digest(1)[7:]}"):
        assert api.refusal("POST", pods, pod(reference), REPLICA_SETS).startswith(f"image {reference} may not run in")
    for source in ({"targetRevision": digest(8)}, {"repoURL": f"{admission.CHARTS}/mqtt-bridge"}):
        other = application(source={**applied["spec"]["source"], **source})
        words = api.refusal("POST", APPLICATIONS, other, GENERATOR)
        assert "that are verified on the catalogue's main are applied" in words
    own = next(c["image"] for _, spec in rendered.pods for c in spec["containers"])
    api.done("POST", path("Deployment", "robotkube") + DRY, workload("Deployment", own))
    assert api.refusal("POST", path("Deployment", "robotkube"), workload("Deployment", VERIFIED))
    api.done("POST", path("Pod", "elsewhere") + DRY, pod(STRANGE))  # other people's
    api.done("DELETE", f"{POLICIES}/validatingadmissionpolicybindings/robotkube-agents")  # as an administrator can
    until(lambda: api.request("POST", pods, pod(STRANGE))["kind"] == "Pod")
