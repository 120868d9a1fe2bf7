"""What the platform's own accounts may do in the cluster: nothing that runs, reads secrets or gives rights.
Exactly what they may, by the same chart on an API server alone: charts/test_rights.py."""

from __future__ import annotations

import base64
import gzip
import subprocess
from collections.abc import Iterator, Mapping
from typing import Any

import pytest
from kubernetes import client, config

from ci.installation import GATE as GATE_NAMESPACE
from ci.installation import KEY_SECRET
from tests.stages.platform.running_platform import Platform

MANAGER = "robotkube/manager"
GATE = f"{GATE_NAMESPACE}/gate"
RUNNER = "robotkube/suite-runner"
CHART_UNDER_TEST = "robotkube-suite-0/application"
SYNCING, GENERATING, SERVING = (
    f"argocd/argocd-{name}" for name in ("application-controller", "applicationset-controller", "server")
)
KEY = f"secrets/{KEY_SECRET}"
ACCOUNTS = (MANAGER, GATE, RUNNER, CHART_UNDER_TEST, "cloud-0/event-detector", "vehicle-00/mqtt-bridge")
NAMESPACES = ("robotkube", GATE_NAMESPACE, "argocd", "cloud-0", "vehicle-00", "default")
WRITE = ("create", "update", "patch", "delete", "deletecollection")
EVERYWHERE = ""
# (verbs, API group, resource, subresource)
FORBIDDEN = (
    (WRITE, "", "pods", ""),
    (WRITE, "apps", "deployments", ""),
    (WRITE, "apps", "statefulsets", ""),
    (WRITE, "batch", "jobs", ""),
    (WRITE, "", "configmaps", ""),
    ((*WRITE, "get", "list"), "", "secrets", ""),
    (("create",), "", "serviceaccounts", "token"),
    (("create", "get"), "", "pods", "exec"),
    (("create", "get"), "", "pods", "attach"),
    ((*WRITE, "bind", "escalate"), "rbac.authorization.k8s.io", "roles", ""),
    ((*WRITE, "bind", "escalate"), "rbac.authorization.k8s.io", "clusterroles", ""),
    (WRITE, "rbac.authorization.k8s.io", "rolebindings", ""),
    (WRITE, "rbac.authorization.k8s.io", "clusterrolebindings", ""),
    (("impersonate",), "", "users", ""),
    (("impersonate",), "", "groups", ""),
    (("impersonate",), "", "serviceaccounts", ""),
    (WRITE, "argoproj.io", "applications", ""),
    (WRITE, "argoproj.io", "applicationsets", ""),
    (WRITE, "argoproj.io", "appprojects", ""),
    (WRITE, "apiextensions.k8s.io", "customresourcedefinitions", ""),
)
# As a person asks: what the words of the rule name, and controls that the question is understood.
ASKED = (
    (MANAGER, "create pods", "no"),
    (MANAGER, "patch deployments.apps", "no"),
    (MANAGER, "get secrets", "no"),
    (MANAGER, "create serviceaccounts --subresource=token", "no"),
    (MANAGER, "create pods --subresource=exec", "no"),
    (MANAGER, "create roles.rbac.authorization.k8s.io", "no"),
    (MANAGER, "bind clusterroles.rbac.authorization.k8s.io", "no"),
    (MANAGER, "escalate clusterroles.rbac.authorization.k8s.io", "no"),
    (MANAGER, "impersonate users", "no"),
    (MANAGER, "patch applications.argoproj.io -n argocd", "no"),
    (MANAGER, "create applicationsets.argoproj.io -n argocd", "no"),
    (MANAGER, "update appprojects.argoproj.io -n argocd", "no"),
    (MANAGER, "create taskdescriptions.robotkube.io -n cloud-0", "yes"),
    (MANAGER, "patch taskdescriptions.robotkube.io -n vehicle-00", "yes"),
    (MANAGER, "delete taskdescriptions.robotkube.io -n vehicle-00", "yes"),
    (MANAGER, "update taskdescriptions.robotkube.io -n vehicle-00", "no"),
    (MANAGER, "deletecollection taskdescriptions.robotkube.io -n vehicle-00", "no"),
    (GATE, "create taskdescriptions.robotkube.io -n cloud-0", "no"),
    (MANAGER, "get nodes", "yes"),
    (MANAGER, "list applications.argoproj.io -n argocd", "yes"),
    (MANAGER, "patch taskdescriptions.robotkube.io --subresource=status -n cloud-0", "yes"),
    (GATE, "get pods", "no"),
    *((account, f"get {KEY} -n {GATE_NAMESPACE}", "no") for account in (MANAGER, GATE, RUNNER, CHART_UNDER_TEST)),
    *((account, f"get {KEY} -n {GATE_NAMESPACE}", "no") for account in (SYNCING, GENERATING, SERVING)),
    (SYNCING, "list secrets -n cloud-0", "no"),
    (SYNCING, "create deployments.apps -n cloud-0", "yes"),
    (SYNCING, "create deployments.apps -n robotkube", "no"),
    (RUNNER, "create deployments.apps -n robotkube-suite-0", "yes"),
    (RUNNER, "create pods -n robotkube-suite-1", "yes"),
    (RUNNER, "create secrets -n robotkube-suite-0", "yes"),
    (RUNNER, "get secrets -n robotkube-suite-0", "no"),
    (RUNNER, "create roles.rbac.authorization.k8s.io -n robotkube-suite-0", "no"),
    (CHART_UNDER_TEST, "get configmaps -n robotkube-suite-0", "yes"),
    (CHART_UNDER_TEST, "get secrets -n robotkube-suite-0", "no"),
    (CHART_UNDER_TEST, "create pods -n robotkube-suite-0", "no"),
    ("cloud-0/event-detector", "create taskdescriptions.robotkube.io -n cloud-0", "yes"),
    ("cloud-0/event-detector", "create taskdescriptions.robotkube.io -n vehicle-00", "no"),
    ("cloud-0/event-detector", "patch taskdescriptions.robotkube.io --subresource=status -n cloud-0", "no"),
    ("cloud-0/event-detector", "get configmaps -n vehicle-00", "no"),
    ("vehicle-00/mqtt-bridge", "watch configmaps -n vehicle-00", "yes"),
    ("vehicle-00/mqtt-bridge", "create taskdescriptions.robotkube.io -n vehicle-00", "no"),
)


def groups(account: str) -> tuple[str, ...]:
    """The groups of a service account `<namespace>/<name>`."""
    namespace = account.partition("/")[0]
    return ("system:serviceaccounts", f"system:serviceaccounts:{namespace}", "system:authenticated")


def user(account: str) -> str:
    """The user name of a service account."""
    return f"system:serviceaccount:{account.replace('/', ':')}"


@pytest.fixture
def reviews(platform: Platform) -> Iterator[client.AuthorizationV1Api]:
    """The question behind `kubectl auth can-i`, asked often over one connection."""
    connection = config.new_client_from_config(str(platform.installer.kubeconfig))
    yield client.AuthorizationV1Api(connection)
    connection.close()


@pytest.mark.thorough
@pytest.mark.parametrize("account", ACCOUNTS)
def test_accounts_of_the_platform_write_nothing_that_runs(reviews: client.AuthorizationV1Api, account: str) -> None:
    allowed = []
    for verbs, group, resource, subresource in FORBIDDEN:
        for verb in verbs:
            for namespace in (*NAMESPACES, EVERYWHERE):
                attributes = client.V1ResourceAttributes(
                    group=group, resource=resource, subresource=subresource, verb=verb, namespace=namespace
                )
                question = client.V1SubjectAccessReviewSpec(
                    user=user(account), groups=list(groups(account)), resource_attributes=attributes
                )
                answer = reviews.create_subject_access_review(client.V1SubjectAccessReview(spec=question))
                if answer.status.allowed:
                    allowed.append(f"{verb} {resource}/{subresource} in {namespace or 'all namespaces'}")
    assert allowed == []


@pytest.mark.thorough
@pytest.mark.parametrize(("account", "question", "expected"), ASKED)
def test_kubectl_says_the_same(platform: Platform, account: str, question: str, expected: str) -> None:
    program = [str(platform.installer.binaries / "kubectl"), "--kubeconfig", str(platform.installer.kubeconfig)]
    impersonate = ["--as", user(account), *(f"--as-group={group}" for group in groups(account))]
    done = subprocess.run(
        [*program, "auth", "can-i", *question.split(), *impersonate],
        capture_output=True, text=True, timeout=30, check=False,
    )  # fmt: skip
    assert (done.stdout.strip(), done.returncode) == (expected, 0 if expected == "yes" else 1), done.stderr


def test_robots_pods_hold_no_token_but_the_mounted_one(platform: Platform) -> None:
    """A service account's token is mounted only where the process needs it."""
    for namespace in ("robotkube", GATE_NAMESPACE, "cloud-0", "vehicle-00", "robotkube-suite-0", "robotkube-suite-1"):
        for account in platform.get("-n", namespace, "serviceaccounts")["items"]:
            if account["metadata"]["name"] != "default":
                assert account.get("automountServiceAccountToken") is False, (namespace, account["metadata"]["name"])


def test_only_the_gate_stands_where_its_key_is(platform: Platform) -> None:
    """And the key stands nowhere else, in no Secret of Helm's releases either."""
    pods = platform.get("-n", GATE_NAMESPACE, "pods")["items"]
    assert {pod["metadata"]["labels"]["app.kubernetes.io/name"] for pod in pods} == {"gate"}
    secrets = platform.get("secrets", "-A")["items"]
    [key] = [secret for secret in secrets if secret["metadata"]["name"] == KEY_SECRET]
    assert key["metadata"]["namespace"] == GATE_NAMESPACE
    body = base64.b64decode(key["data"]["key.pem"]).decode().splitlines()[1]
    assert [secret["metadata"]["name"] for secret in secrets if body in texts(secret)] == [KEY_SECRET]


def texts(secret: Mapping[str, Any]) -> str:
    """What a Secret says; a release of Helm's is compressed and encoded once more."""
    values = [base64.b64decode(value) for value in secret.get("data", {}).values()]
    if secret["type"] == "helm.sh/release.v1":
        values = [gzip.decompress(base64.b64decode(value)) for value in values]
    return "".join(value.decode(errors="replace") for value in values)
