"""What a real API server lets Argo CD be told under the policies from files: Applications and projects."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from robotkube.registry.admission.core.policies import for_files
from tests.stages.attacks import shown
from tests.stages.kubernetes.judged_api_server import ADMINISTRATOR, JSON_PATCH, MERGE, Api, judged_api_server
from tests.stages.registry.admission_examples import (
    ALLOWED,
    APPLICATION_CONTROLLER,
    APPLICATIONS,
    CHART,
    CHARTS,
    DOMAIN,
    GENERATOR,
    PROJECTS,
    SERVER,
    STRANGE,
    application,
    digest,
)

pytestmark = [pytest.mark.toolchain]  # a server of its own


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with judged_api_server(tmp_path_factory.mktemp("api"), for_files(DOMAIN, ALLOWED), schemas=True) as (api, _):
        for name in ("vehicle-00", "argocd"):
            api.done("POST", "/api/v1/namespaces", {"metadata": {"name": name}})
        yield api


SOURCE = application()["spec"]["source"]
TO_CLUSTER = {"server": "https://kubernetes.default.svc"}
ONE_CHART = " is more than one chart with its values: it has several sources, a key that releases do not use"
NOT_VERIFIED = f": only charts of {CHARTS} that are verified on the catalogue's main are applied, by digest."
IN_AGENTS = "but releases run in agents' namespaces of this cluster alone. Correct metadata.namespace of the release"
ATTACKS: dict[str, tuple[dict[str, Any], str]] = {
    "another project": ({"project": "default"}, "is in project default, not in robotkube-apps, the one that limits"),
    "the platform's namespace": ({"destination": {**TO_CLUSTER, "namespace": "robotkube"}}, IN_AGENTS),
    "no namespace": ({"destination": TO_CLUSTER}, IN_AGENTS),
    "another cluster": ({"destination": {"server": "https://example.org", "namespace": "vehicle-00"}}, IN_AGENTS),
    "a cluster by name": ({"destination": {"name": "in-cluster", "namespace": "vehicle-00"}}, IN_AGENTS),
    "a foreign registry": (
        {"source": {**SOURCE, "repoURL": "oci://example.org/verified/event-detector"}}, NOT_VERIFIED),
    "the staging area": (
        {"source": {**SOURCE, "repoURL": CHARTS.replace("/verified", "/staging/event-detector")}}, NOT_VERIFIED),
    "a way out of it": ({"source": {**SOURCE, "repoURL": f"{CHARTS}/../staging/event-detector"}}, NOT_VERIFIED),
    "another chart of the digest": ({"source": {**SOURCE, "repoURL": f"{CHARTS}/mqtt-bridge"}}, NOT_VERIFIED),
    "another digest": ({"source": {**SOURCE, "targetRevision": digest(8)}}, NOT_VERIFIED),
    "a tag": ({"source": {**SOURCE, "targetRevision": "1.0.0"}}, NOT_VERIFIED),
    "no revision": ({"source": {key: SOURCE[key] for key in SOURCE if key != "targetRevision"}}, NOT_VERIFIED),
    "a repository of Git": ({"source": {"repoURL": "https://example.org/a.git", "path": "."}}, NOT_VERIFIED),
    "a plug-in": ({"source": {**SOURCE, "plugin": {"name": "sh"}}}, ONE_CHART),
    "another folder": ({"source": {**SOURCE, "path": "charts/other"}}, ONE_CHART),
    "several sources": ({"sources": [SOURCE, {"repoURL": "https://example.org/a.git", "path": "."}]}, ONE_CHART),
    "values from an address": (
        {"source": {**SOURCE, "helm": {"valueFiles": ["http://10.0.0.1/secret"]}}}, ONE_CHART),
    "a parameter without a name": (
        {"source": {**SOURCE, "helm": {"parameters": [{"value": STRANGE}]}}}, ONE_CHART),
    "a parameter": (
        {"source": {**SOURCE, "helm": {"parameters": [{"name": "image.reference", "value": STRANGE}]}}}, ONE_CHART),
    "differences ignored": (
        {"ignoreDifferences": [{"group": "apps", "kind": "Deployment", "jsonPointers": ["/spec"]}]}, ONE_CHART),
    "labels of namespaces": (
        {"syncPolicy": {"managedNamespaceMetadata": {"labels": {"pod-security.kubernetes.io/enforce": "privileged"}}}},
        ONE_CHART),
}  # fmt: skip


@pytest.mark.parametrize("attack", ATTACKS)
def test_an_application_of_anything_else_is_refused(api: Api, attack: str) -> None:
    """Written by the ApplicationSet controller's account, which may write every Application."""
    spec, expected = ATTACKS[attack]
    words = api.refusal("POST", APPLICATIONS, application(**spec), GENERATOR)
    assert words.startswith("Application vehicle-00-detector ")
    assert expected in words
    if expected == NOT_VERIFIED:
        shown("admission", words, "application-by-argocd", "status-forged", "withdrawn-version")
        shown("admission", words, "main-moved-past-the-gate", "break-glass-claimed", "staged-tag-overwritten")


@pytest.mark.parametrize("user", [ADMINISTRATOR, SERVER])
def test_applications_are_written_by_argo_cds_generator(api: Api, user: str) -> None:
    assert api.refusal("POST", APPLICATIONS, application(), user) == (
        f"Application vehicle-00-detector written by {user or 'administrator'}: Argo CD's ApplicationSet controller "
        "alone writes them, from main. Propose a release instead"
    )


@pytest.fixture
def applied(api: Api) -> Iterator[str]:
    """The address of an Application."""
    api.done("POST", APPLICATIONS, application(), GENERATOR)
    address = f"{APPLICATIONS}/vehicle-00-detector"
    yield address
    api.done("DELETE", address)


def test_what_argo_cd_notes_on_an_application_passes(api: Api, applied: str) -> None:
    status = {"status": {"sync": {"status": "Synced", "comparedTo": {"source": SOURCE, "destination": {}}}}}
    refresh = {"metadata": {"annotations": {"argocd.argoproj.io/refresh": "normal"}}}
    automated = {"operation": {"sync": {"revision": CHART}, "initiatedBy": {"automated": True}}}
    api.done("PATCH", applied, status, APPLICATION_CONTROLLER, MERGE)
    api.done("PATCH", applied, refresh, SERVER, MERGE)
    api.done("PATCH", applied, automated, APPLICATION_CONTROLLER, MERGE)
    api.done("PATCH", applied, {"operation": None}, APPLICATION_CONTROLLER, MERGE)
    api.done("PATCH", applied, {"operation": {"sync": {"source": SOURCE}}}, APPLICATION_CONTROLLER, MERGE)
    state = {"operation": {}, "phase": "Succeeded", "startedAt": "2026-11-24T10:00:00Z"}
    ended = {"/status/operationState": state, "/operation": None}
    patch = [{"op": "add", "path": place, "value": value} for place, value in ended.items()]
    assert "operation" not in api.done("PATCH", applied, patch, APPLICATION_CONTROLLER, JSON_PATCH)


def test_a_release_changes_while_argo_cd_still_applies_what_it_was(api: Api, applied: str) -> None:
    """The operation names the source that the Application had when it began."""
    own = {"sync": {"source": SOURCE, "revision": CHART}, "initiatedBy": {"automated": True}}
    api.done("PATCH", applied, {"operation": own}, APPLICATION_CONTROLLER, MERGE)
    helm = {**SOURCE["helm"], "values": '{"placement":{"agent":"vehicle-00"},"more":1}'}
    api.done("PATCH", applied, {"spec": {"source": {"helm": helm}}}, GENERATOR, MERGE)
    api.done("PATCH", applied, {"status": {"sync": {"status": "OutOfSync"}}}, APPLICATION_CONTROLLER, MERGE)
    turned = {"operation": {"sync": {"source": {**SOURCE, "targetRevision": digest(8)}}}}
    words = api.refusal("PATCH", applied, turned, APPLICATION_CONTROLLER, MERGE)
    assert words.startswith("Application vehicle-00-detector: operation.sync names another source or revision")


OPERATIONS: dict[str, dict[str, Any]] = {
    "another source": {"source": {**SOURCE, "targetRevision": digest(8)}},
    "several sources": {"sources": [SOURCE]},
    "another revision": {"revision": digest(8)},
    "several revisions": {"revisions": [CHART]},
    "manifests": {"manifests": ["apiVersion: v1"]},
}


@pytest.mark.parametrize("operation", OPERATIONS)
@pytest.mark.parametrize("user", [ADMINISTRATOR, SERVER, APPLICATION_CONTROLLER])
def test_an_operation_brings_nothing_of_its_own(api: Api, applied: str, operation: str, user: str) -> None:
    words = api.refusal("PATCH", applied, {"operation": {"sync": OPERATIONS[operation]}}, user, MERGE)
    assert words.startswith("Application vehicle-00-detector: operation.sync names another source or revision")
    shown("admission", words, "operation-with-source")


def test_an_application_that_is_there_is_not_turned(api: Api, applied: str) -> None:
    turned = {"spec": {"source": {"targetRevision": digest(8)}}}
    assert NOT_VERIFIED in api.refusal("PATCH", applied, turned, GENERATOR, MERGE)
    assert "written by administrator" in api.refusal("PATCH", applied, turned, kind=MERGE)


def test_argo_cd_does_not_widen_the_project_of_releases(api: Api) -> None:
    head = {"apiVersion": "argoproj.io/v1alpha1", "kind": "AppProject", "metadata": {"name": "robotkube-apps"}}
    words = f"AppProject robotkube-apps changed by {SERVER}: who installs the platform says what releases may be made"
    refused = api.refusal("POST", PROJECTS, {**head, "spec": {}}, SERVER)
    assert refused.startswith(words)
    shown("admission", refused, "project-widened")
    api.done("POST", PROJECTS, {**head, "spec": {}})
    wider = {"spec": {"clusterResourceWhitelist": [{"group": "*", "kind": "*"}]}}
    assert api.refusal("PATCH", f"{PROJECTS}/robotkube-apps", wider, SERVER, MERGE).startswith(words)
    api.done("PATCH", f"{PROJECTS}/robotkube-apps", {"metadata": {"labels": {"a": "b"}}}, SERVER, MERGE)
    api.done("PATCH", f"{PROJECTS}/robotkube-apps", wider, kind=MERGE)
    default = {**head, "metadata": {"name": "default"}, "spec": {}}
    api.done("POST", PROJECTS, default, SERVER)  # argocd-server makes it when it starts
