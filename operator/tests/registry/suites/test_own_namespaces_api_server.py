"""Test namespaces with one's own rights on a real API server with Kubernetes' own controllers and the platform's
admission: made as the platform's are, with no more rights than are named, refused in words, and gone at the end."""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.cli.platform import Platform
from robotkube.cli.registry.reaching import Reached
from robotkube.cli.registry.trying_on_cluster import ClusterMeans, cluster_means
from robotkube.foundation.kubernetes.adapters.client import api_client, call
from robotkube.registry.admission.adapters.policy_files import PolicyFiles
from robotkube.registry.admission.core.policies import for_files
from robotkube.registry.suites.adapters.own_namespaces import KubernetesOwnNamespaces
from robotkube.registry.suites.core.namespace_contents import HelperPod
from robotkube.registry.suites.core.own_namespaces import KINDS, needed_rights
from tests.stages.kubernetes.api_calls import Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.kubernetes.controllers import controlling
from tests.stages.paths import REPOSITORY
from tests.stages.registry.admission_examples import ALLOWED, DOMAIN, STRANGE, VERIFIED
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

SOURCE, OWN, PLATFORM = "robotkube-suite-0", "robotkube-try-1", "robotkube"
GOLDEN = REPOSITORY / "operator" / "tests" / "charts" / "golden" / "embedded.yaml"
ACCOUNTS = "/api/v1/namespaces/default/serviceaccounts"
ROLES = "/apis/rbac.authorization.k8s.io/v1/clusterroles"
BINDINGS = "/apis/rbac.authorization.k8s.io/v1/clusterrolebindings"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiServerProcess]:
    folder = tmp_path_factory.mktemp("api")
    files = PolicyFiles(folder / "admission")
    files.write(for_files(DOMAIN, ALLOWED))
    options = tuple(f"--{name}={value}" for name, value in files.options.items())
    process = ApiServerProcess(folder, options, gives_tokens=True)
    try:
        process.start()
        with controlling(folder, process.kubeconfig):
            yield process
    finally:
        process.stop()


@pytest.fixture(scope="module")
def administrator(server: ApiServerProcess) -> Iterator[Api]:
    """The administrator, and a test namespace as the platform's chart makes it."""
    api = Api(api_client(str(server.kubeconfig)), server.kubeconfig)
    for name in (SOURCE, PLATFORM):
        api.post("/api/v1/namespaces", {"metadata": {"name": name}})
    kinds = {kind.kind: kind.path for kind in KINDS} | {"ConfigMap": "/api/v1/namespaces/{}/configmaps"}
    for item in yaml.load_all(GOLDEN.read_text(), Loader=yaml.CSafeLoader):
        namespace = (item or {}).get("metadata", {}).get("namespace", PLATFORM)
        runner = item and (item["kind"], item["metadata"]["name"]) == ("ConfigMap", "suite-runner")
        if item and item["kind"] in kinds and (namespace == SOURCE or runner):
            api.post(kinds[item["kind"]].format(namespace), item)
    yield api
    api.client.rest_client.pool_manager.clear()


@pytest.fixture
def account(server: ApiServerProcess, administrator: Api, tmp_path: Path) -> Iterator[Callable[[str], Api]]:
    """The API as a new account of this name, which may nothing yet."""
    made: list[Api] = []

    def become(name: str) -> Api:
        administrator.post(ACCOUNTS, {"metadata": {"name": name}})
        body = {"apiVersion": "authentication.k8s.io/v1", "kind": "TokenRequest", "spec": {"expirationSeconds": 600}}
        answer = call(administrator.client, "POST", f"{ACCOUNTS}/{name}/token", body=body)
        access = tmp_path / name
        access.write_text(
            server.kubeconfig.read_text().replace(server.token, json.loads(answer.data)["status"]["token"])
        )
        made.append(Api(api_client(str(access)), access))
        return made[-1]

    yield become
    for api in made:
        api.client.rest_client.pool_manager.clear()


def allow(administrator: Api, name: str, without: str = "") -> None:
    """Give an account what the command says that it needs, but what is named `without`."""
    rights = [right for right in needed_rights(OWN, SOURCE) if str(right) != without]
    rules = [{"apiGroups": [one.group], "resources": [one.resource], "verbs": [one.verb]} for one in rights]
    administrator.post(ROLES, {"metadata": {"name": name}, "rules": rules})
    role = {"apiGroup": "rbac.authorization.k8s.io", "kind": "ClusterRole", "name": name}
    subject = {"kind": "ServiceAccount", "name": name, "namespace": "default"}
    administrator.post(BINDINGS, {"metadata": {"name": name}, "roleRef": role, "subjects": [subject]})


def namespaces(api: Api) -> KubernetesOwnNamespaces:
    return KubernetesOwnNamespaces(functools.partial(call, api.client), SOURCE)


def pod(image: str, **spec: Any) -> dict[str, Any]:
    document = HelperPod("suite-probe", image, "cloud-0", 89).document()
    document["spec"] |= spec
    return document


def test_with_exactly_the_named_rights_it_is_made_and_removed(
    administrator: Api, account: Callable[[str], Api]
) -> None:
    api = account("enough")
    allow(administrator, "enough")
    own = namespaces(api)
    until(lambda: own.missing_rights(OWN) == [], "the rights are there")
    own.make(OWN, 60)
    try:
        for kind in KINDS:
            here, there = (administrator.get(kind.path.format(where))["items"] for where in (OWN, SOURCE))
            expected = {one["metadata"]["name"] for one in there if kind.only in ("", one["metadata"]["name"])}
            assert {one["metadata"]["name"] for one in here} >= expected - {"default"}, kind
            assert expected, kind
        assert own.refusal(OWN, pod(VERIFIED)) == ""
        assert own.refusal(OWN, pod(STRANGE)).startswith(f"image {STRANGE} may not run in namespace {OWN}")
        assert "PodSecurity" in own.refusal(OWN, pod(VERIFIED, securityContext={"runAsUser": 0}))
        assert own.remove_left_behind() == [], "its maker, this process, runs"
        assert namespaces_of_another_time(api).remove_left_behind() == [OWN]
        until(lambda: own.is_gone(OWN), "the namespace is gone")
    finally:
        own.remove(OWN)


def namespaces_of_another_time(api: Api) -> KubernetesOwnNamespaces:
    """As they are seen when the time of every try that runs now is over."""
    return KubernetesOwnNamespaces(
        functools.partial(call, api.client), SOURCE, now_ns=lambda: 4_000_000_000_000_000_000
    )


def means(api: Api) -> ClusterMeans:
    """What the command would run with this kubeconfig."""
    options = argparse.Namespace(
        kubeconfig=str(api.kubeconfig),
        context=None,
        platform_namespace=PLATFORM,
        argocd_namespace="argocd",
        manager="m",
    )
    with contextlib.ExitStack() as stack:
        return cluster_means(Reached(platform=Platform(options)), stack)


def test_missing_rights_are_named_before_anything_is_made(administrator: Api, account: Callable[[str], Api]) -> None:
    api = account("little")
    assert "the cluster cannot be used: API server: GET" in means(api).problem
    lacking = f"create pods in namespace {OWN}"
    allow(administrator, "little", without=lacking)
    reader = {
        "metadata": {"name": "reader"},
        "rules": [{"apiGroups": [""], "resources": ["configmaps"], "verbs": ["get"]}],
    }
    administrator.post(ROLES, reader)
    until(lambda: namespaces(api).missing_rights(OWN) == [lacking], "the rights are there")
    assert (
        means(api).problem
        == "your account may not: create pods in namespace robotkube-try-x. Ask for these rights, or submit"
    )


def test_who_has_the_rights_can_run_both_suites(administrator: Api) -> None:
    own_means = means(administrator)
    assert (own_means.problem, sorted(own_means.suites)) == ("", ["install", "interface"])
