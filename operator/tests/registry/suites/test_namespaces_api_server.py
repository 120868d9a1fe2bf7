"""Test namespaces on a real API server, with the account and rights that the platform's chart gives: what charts and
helpers are is accepted there (Pod Security restricted), and outside the pool nothing is possible. There is no kubelet:
a thread of the test does what kubelets and controllers do to pods."""

from __future__ import annotations

import contextlib
import functools
import json
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.kubernetes.adapters.client import api_client, call
from robotkube.registry.suites.adapters.namespace_objects import KubernetesNamespaceObjects
from robotkube.registry.suites.loops.cluster_namespace import ClusterTestNamespace, SuiteNamespaceSettings
from robotkube.registry.suites.loops.namespace_cleanup import ClusterNamespaceCleaner
from robotkube.registry.suites.ports.suites import SuiteAccount
from robotkube.testing.suites import deployment
from tests.stages.kubernetes.api_calls import Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.paths import CHART_PROFILES, CHARTS
from tests.stages.programs import program
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

NAMESPACE, OTHER = "robotkube-suite-0", "robotkube-suite-1"
KINDS = ("Namespace", "Role", "RoleBinding", "ServiceAccount", "LimitRange")
PATHS = {
    "Namespace": "/api/v1/namespaces",
    "ServiceAccount": "/api/v1/namespaces/{}/serviceaccounts",
    "LimitRange": "/api/v1/namespaces/{}/limitranges",
    "Role": "/apis/rbac.authorization.k8s.io/v1/namespaces/{}/roles",
    "RoleBinding": "/apis/rbac.authorization.k8s.io/v1/namespaces/{}/rolebindings",
}
SETTINGS = SuiteNamespaceSettings(
    NAMESPACE, 90, "cloud-0", "ros:1", "mosquitto:1", "ferretdb", "ferretdb:1", ("--handler=sqlite",)
)
GREETER = deployment(
    securityContext={"runAsNonRoot": True, "runAsUser": 10001, "seccompProfile": {"type": "RuntimeDefault"}}
)
CONTAINER = {
    "name": "main",
    "image": "greeter:1",
    "securityContext": {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}},
}
GREETER["spec"]["template"]["spec"]["containers"] = [CONTAINER]


def config_map(**data: str) -> dict[str, Any]:
    return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": {"name": "greeter"}, "data": data}


@pytest.fixture(scope="session")
def pool(api_server: ApiServerProcess) -> ApiServerProcess:
    """The pool and the runner's account, as charts/robotkube makes them."""
    words = [
        "template",
        "robotkube",
        str(CHARTS / "robotkube"),
        "-n",
        "robotkube",
        "-f",
        str(CHART_PROFILES / "official.yaml"),
    ]
    done = subprocess.run([program("helm"), *words], capture_output=True, text=True, timeout=60, check=True)
    api = Api(api_client(str(api_server.kubeconfig)))
    of_pool = [item for item in yaml.load_all(done.stdout, Loader=yaml.CSafeLoader) if item and item["kind"] in KINDS]
    for item in sorted(of_pool, key=lambda item: KINDS.index(item["kind"])):
        namespace = item["metadata"].get("namespace", "robotkube")
        if namespace.startswith("robotkube-suite-") or item["metadata"]["name"].startswith(
            ("robotkube-suite-", "suite-")
        ):
            api.post(PATHS[item["kind"]].format(namespace), item)
    return api_server


@pytest.fixture
def runner(pool: ApiServerProcess, api: Api, tmp_path: Path) -> Iterator[Api]:
    """The API as the account suite-runner."""
    path = "/api/v1/namespaces/robotkube/serviceaccounts/suite-runner/token"
    body = {"apiVersion": "authentication.k8s.io/v1", "kind": "TokenRequest", "spec": {"expirationSeconds": 600}}
    token = json.loads(call(api.client, "POST", path, body=body).data)["status"]["token"]
    access = tmp_path / "kubeconfig"
    access.write_text(pool.kubeconfig.read_text().replace(pool.token, token))
    as_runner = Api(api_client(str(access)))
    yield as_runner
    as_runner.client.rest_client.pool_manager.clear()


@pytest.fixture
def objects(runner: Api) -> KubernetesNamespaceObjects:
    return KubernetesNamespaceObjects(functools.partial(call, runner.client), NAMESPACE)


class Stage:
    """A test namespace whose accounts in databases are noted instead of made, and its cleaner."""

    def __init__(self, objects: KubernetesNamespaceObjects, seconds: float = 60.0) -> None:
        self.accounts: list[SuiteAccount] = []
        self.namespace = ClusterTestNamespace(
            objects, SETTINGS, seconds, lambda administrator, account: self.accounts.append(account)
        )
        self.cleaner = ClusterNamespaceCleaner(objects, SETTINGS)


PodStatus = Callable[[Mapping[str, Any]], Mapping[str, Any] | None]


class Kubelet:
    """Gives every new pod of the test namespace the status that `status(pod)` says."""

    def __init__(self, api: Api, status: PodStatus) -> None:
        self._api = api
        self._status = status
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Kubelet:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join(10)

    def _run(self) -> None:
        path = f"/api/v1/namespaces/{NAMESPACE}/pods"
        while not self._stopping.wait(0.05):
            for pod in json.loads(call(self._api.client, "GET", path).data)["items"]:
                status = self._status(pod)
                if status and pod["status"]["phase"] == "Pending":
                    with contextlib.suppress(KeyError):  # deleted meanwhile
                        self._api.merge(f"{path}/{pod['metadata']['name']}/status", {"status": status})


def ended(pod: Mapping[str, Any], code: int = 0) -> dict[str, Any]:
    state = {"terminated": {"exitCode": code, "finishedAt": "2026-11-21T10:00:01Z"}}
    name = pod["spec"]["containers"][0]["name"]
    status = {"name": name, "image": "i", "imageID": "", "ready": False, "restartCount": 0, "state": state}
    return {"phase": "Failed" if code else "Succeeded", "containerStatuses": [status]}


def cleaned(pod: Mapping[str, Any]) -> dict[str, Any] | None:
    return ended(pod) if pod["metadata"]["name"] == "suite-clean" else None


@pytest.fixture
def stage(objects: KubernetesNamespaceObjects, api: Api) -> Iterator[Stage]:
    stage = Stage(objects)
    with Kubelet(api, cleaned):
        stage.cleaner.empty(20)
        yield stage
        stage.cleaner.empty(20)
    assert stage.namespace.leftovers() == []


def ready(pod: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "phase": "Running",
        "conditions": [{"type": "Ready", "status": "True"}],
        "podIPs": [{"ip": "10.0.0.9"}],
        "podIP": "10.0.0.9",
    }


def test_a_charts_objects_are_made_replaced_and_deleted(stage: Stage, objects: KubernetesNamespaceObjects) -> None:
    stage.namespace.apply([GREETER, config_map(a="1", b="2")])
    assert stage.namespace.leftovers() == ["ConfigMap greeter", "Deployment greeter"]
    stage.namespace.apply([GREETER, config_map(a="3")])
    read_back = objects.get("ConfigMap", "greeter")
    assert read_back is not None
    assert read_back["data"] == {"a": "3"}, "what the new version has not is gone"
    applied = objects.get("Deployment", "greeter")
    assert applied is not None
    [container] = applied["spec"]["template"]["spec"]["containers"]
    assert container["env"] == [{"name": "ROS_DOMAIN_ID", "value": "90"}]
    assert stage.namespace.delete([GREETER, config_map()], 5) == []
    assert stage.namespace.leftovers() == []


def test_what_the_api_server_refuses_is_said_in_its_words(stage: Stage) -> None:
    wrong = {**GREETER, "spec": {**GREETER["spec"], "selector": {"matchLabels": {"app": "other"}}}}
    with pytest.raises(InputError, match="selector"):
        stage.namespace.apply([wrong])
    unknown = {**GREETER, "spec": {**GREETER["spec"], "replica": 2}}
    with pytest.raises((InputError, UnavailableError), match="replica"):
        stage.namespace.apply([unknown])


def test_a_helper_pod_is_let_in_and_its_end_is_seen(stage: Stage, api: Api) -> None:
    with Kubelet(api, lambda pod: ended(pod, 3)):
        files = {"a.json": b"{}", "chart.tgz": b"\x1f\x8b\x00"}
        run = stage.namespace.run_pod("look", "ros:1", ["look"], files, 20, volume_claim=True, accounts=True)
    assert (run.exit_code, run.problem) == (3, "")


def test_a_helper_pod_that_never_starts(stage: Stage) -> None:
    run = stage.namespace.run_pod("look", "ros:1", [], {}, 1)
    assert run.exit_code is None
    assert "it did not end in its time" in run.problem
    assert "Pending" in run.problem


def test_broker_and_database_are_let_in(stage: Stage, api: Api) -> None:
    with Kubelet(api, ready):
        broker = stage.namespace.start_broker()
        database = stage.namespace.start_database()
    assert (broker.host, broker.port, database.host) == ("10.0.0.9", 1883, "10.0.0.9")
    assert stage.accounts == [database]
    for name, key in (("broker-account", "host"), ("database-account", "authenticationDatabase")):
        secret = json.loads(call(api.client, "GET", f"/api/v1/namespaces/{NAMESPACE}/secrets/{name}").data)
        assert key in secret["data"]
    stage.cleaner.empty(20)
    assert json.loads(call(api.client, "GET", f"/api/v1/namespaces/{NAMESPACE}/secrets").data)["items"] == []


def pod_on_a_node(name: str) -> dict[str, Any]:
    """A pod that is deleted as one on a node is: when somebody says that it has ended."""
    labels = {"robotkube.io/suite": "subject"}
    spec = {**GREETER["spec"]["template"]["spec"], "nodeName": "n1", "terminationGracePeriodSeconds": 3}
    return {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": name, "labels": labels}, "spec": spec}


def test_how_a_pod_ended_is_seen_until_it_is_gone(stage: Stage, api: Api) -> None:
    stage.namespace.apply([GREETER])
    path = f"/api/v1/namespaces/{NAMESPACE}/pods"
    api.post(path, pod_on_a_node("greeter-1"))
    ends: list[Any] = []
    thread = threading.Thread(target=lambda: ends.extend(stage.namespace.delete([GREETER], 20)))
    thread.start()
    until(lambda: stage.namespace.leftovers() == ["Pod greeter-1"], "Deployment deleted")
    call(api.client, "DELETE", f"{path}/greeter-1").close()
    pod = json.loads(call(api.client, "GET", f"{path}/greeter-1").data)
    api.merge(f"{path}/greeter-1/status", {"status": ended(pod, 137)})
    api.delete(f"{path}/greeter-1")
    thread.join(20)
    [end] = ends
    assert (end.name, end.gone, end.exit_codes, end.grace_seconds) == ("greeter-1", True, {"main": 137}, 3.0)


def test_a_pod_that_stays_is_emptied_by_force(stage: Stage, api: Api) -> None:
    path = f"/api/v1/namespaces/{NAMESPACE}/pods"
    api.post(path, pod_on_a_node("greeter-1"))
    [end] = stage.namespace.delete([], 1)
    assert not end.gone
    with pytest.raises(UnavailableError, match="still there after the time for emptying: Pod greeter-1"):
        stage.cleaner.empty(1)
    pod = json.loads(call(api.client, "GET", f"{path}/greeter-1").data)
    assert pod["metadata"]["deletionGracePeriodSeconds"] == 1
    api.delete(f"{path}/greeter-1")


SECRETS = f"/api/v1/namespaces/{NAMESPACE}/secrets"


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", SECRETS),
        ("GET", f"{SECRETS}/broker-account"),
        ("POST", f"/api/v1/namespaces/{NAMESPACE}/services"),
        ("POST", f"/api/v1/namespaces/{NAMESPACE}/serviceaccounts/application/token"),
        ("POST", f"/api/v1/namespaces/{NAMESPACE}/pods/greeter-1/exec"),
        ("POST", f"/apis/batch/v1/namespaces/{NAMESPACE}/jobs"),
        ("POST", f"/apis/rbac.authorization.k8s.io/v1/namespaces/{NAMESPACE}/roles"),
        ("POST", "/api/v1/namespaces/robotkube/pods"),
        ("POST", "/api/v1/namespaces/cloud-0/configmaps"),
        ("POST", "/api/v1/namespaces/default/secrets"),
        ("POST", "/apis/apps/v1/namespaces/argocd/deployments"),
        ("GET", "/api/v1/namespaces/robotkube-gate/secrets/gate-key"),
        ("GET", "/api/v1/namespaces/robotkube/configmaps"),
        ("POST", "/api/v1/namespaces"),
        ("GET", "/api/v1/pods"),
        ("GET", "/api/v1/nodes"),
    ],
)
def test_what_the_runner_may_not(runner: Api, method: str, path: str) -> None:
    with pytest.raises(InputError, match="403"):
        call(runner.client, method, path, body={} if method == "POST" else None)


def test_both_namespaces_are_the_runners(runner: Api) -> None:
    for namespace in (NAMESPACE, OTHER):
        answer = call(runner.client, "GET", f"/api/v1/namespaces/{namespace}/pods")
        assert json.loads(answer.data)["items"] == []
