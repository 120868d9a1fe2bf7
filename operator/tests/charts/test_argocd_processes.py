"""Argo CD's own programs, installed as in the embedded cluster and set up by the bootstrap: whom they let in."""

from __future__ import annotations

import base64
import copy
import hmac
import json
import socket
import ssl
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from kubernetes import config

from ci.client_certificates import client_certificate
from ci.installation import Installer
from robotkube.registry.admission.core.policies import for_files
from robotkube.setup.adapters.argocd_configuration import KubernetesArgoCDConfiguration
from robotkube.setup.loops.bootstrap import ArgoCDSetup, Bootstrap
from tests.charts.conftest import Rendered
from tests.stages import http_calls
from tests.stages.attacks import shown
from tests.stages.kubernetes.argocd_processes import NAMESPACE, generating, rendering, serving
from tests.stages.kubernetes.installed_chart import Cluster, prepared_cluster
from tests.stages.programs import program
from tests.stages.registry.admission_examples import ALLOWED, CHART, DOMAIN, OF_THE_PLATFORM, REPLICA_SETS, digest
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

IMAGES = {"argocd": OF_THE_PLATFORM, "redis": OF_THE_PLATFORM}
SETUP = ArgoCDSetup(
    account="manager",
    password="password of the manager",  # noqa: S106
    rbac="p, role:x, applications, get, robotkube-apps/*, allow\ng, manager, role:x\n",
    hook_secret="secret of the hook",  # noqa: S106
    closed_project="default",
    hook_readers=("argocd-server", "argocd-applicationset-controller"),
)
ANSWER_SECONDS_MAX = 30.0
REPOSITORY = "http://forge.robotkube.svc.cluster.local:3000/robotkube/deployment"
PUSH = {"ref": "refs/heads/main", "before": "0" * 40, "after": "1" * 40}
# As each forge sends a push: headers, and the body that its reader takes.
HOOKS: dict[str, tuple[dict[str, str], dict[str, Any]]] = {
    "github": (
        {"X-GitHub-Event": "push"},
        {**PUSH, "repository": {"html_url": REPOSITORY, "default_branch": "main"}},
    ),
    "github packages": ({"X-GitHub-Event": "package"}, {"action": "published"}),
    "gitlab": (
        {"X-Gitlab-Event": "Push Hook"},
        {**PUSH, "object_kind": "push", "project": {"web_url": REPOSITORY, "default_branch": "main"}},
    ),
    "gogs": ({"X-Gogs-Event": "push"}, {**PUSH, "repository": {"html_url": REPOSITORY, "default_branch": "main"}}),
    "bitbucket": (
        {"X-Hook-UUID": "any", "X-Event-Key": "repo:push"},
        {"repository": {"links": {"html": {"href": REPOSITORY}}}, "push": {"changes": []}},
    ),
    "bitbucket server": ({"X-Event-Key": "repo:refs_changed"}, {"changes": []}),
    "azure devops": (
        {"X-Vss-Activityid": "any"},
        {
            "eventType": "git.push",
            "resource": {
                "repository": {"remoteUrl": REPOSITORY, "defaultBranch": "refs/heads/main"},
                "refUpdates": [{"name": "refs/heads/main", "newObjectId": "1" * 40, "oldObjectId": "0" * 40}],
            },
        },
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("argocd")


@pytest.fixture(scope="module")
def installed(folder: Path) -> Iterator[Cluster]:
    """Argo CD's objects on an API server without nodes, under admission."""
    with prepared_cluster(folder, for_files(DOMAIN, ALLOWED), kinds=()) as cluster:
        Installer(Path(program("kubectl")).parent, cluster.kubeconfig, folder).argocd(IMAGES)
        yield cluster


def test_its_namespace_takes_restricted_pods_only_and_its_own_are(installed: Cluster) -> None:
    """Asked for as by controllers, whom admission lets make pods of these images."""

    def created(name: str, spec: dict[str, Any]) -> str:
        """What the API server says to this pod."""
        text = json.dumps({"apiVersion": "v1", "kind": "Pod", "metadata": {"name": name}, "spec": spec})
        create = ("create", "-n", NAMESPACE, "--dry-run=server", "--as", REPLICA_SETS, "-f", "-")
        done = installed.run("kubectl", *create, text=text)
        return done.stdout.strip() or done.stderr

    listed = json.loads(installed.kubectl("get", "deployments,statefulsets", "-n", NAMESPACE, "-o", "json"))["items"]
    pods = {one["metadata"]["name"]: one["spec"]["template"]["spec"] for one in listed}
    assert len(pods) == 5
    for name, spec in pods.items():
        assert created(name, spec) == f"pod/{name} created (server dry run)"
    as_root = {**pods["argocd-redis"], "securityContext": {}}
    assert 'violates PodSecurity "restricted:latest"' in created("as-root", as_root)


@pytest.fixture(scope="module")
def server(installed: Cluster, folder: Path) -> Iterator[str]:
    """argocd-server, set up by the steps of the bootstrap Job, and then restarted as they restart its Deployment."""
    bootstrap = Bootstrap(60, time.monotonic, time.sleep)
    with serving(installed, folder):
        connection = config.new_client_from_config(str(installed.kubeconfig))
        bootstrap.argocd(SETUP, KubernetesArgoCDConfiguration(connection, NAMESPACE))
        connection.close()
    assert [f"deployment {reader}" for reader in SETUP.hook_readers] == bootstrap.changed[-2:]
    with serving(installed, folder) as url:
        until(lambda: log_in(url, SETUP.account, SETUP.password).is_success, "the manager's account is known")
        yield url


@pytest.fixture(scope="module")
def controller(installed: Cluster, server: str, folder: Path) -> Iterator[str]:
    """The ApplicationSet controller, started after the set-up."""
    with generating(installed, folder) as url:
        until(lambda: send(url, {}, {}).status_code == 400, "the controller hears hooks")
        yield url


def send(url: str, headers: dict[str, str], body: dict[str, Any], secret: str = "") -> httpx.Response:
    """The answer to a hook, signed as GitHub does when there is a secret."""
    content = json.dumps(body).encode()
    if secret:
        headers = headers | {"X-Hub-Signature-256": "sha256=" + hmac.digest(secret.encode(), content, "sha256").hex()}
    headers = headers | {"Content-Type": "application/json"}
    try:
        return http_calls.post(f"{url}/api/webhook", headers=headers, content=content, timeout=ANSWER_SECONDS_MAX)
    except httpx.HTTPError:
        return httpx.Response(503)


def log_in(url: str, username: str, password: str) -> httpx.Response:
    account = {"username": username, "password": password}
    try:
        return http_calls.post(f"{url}/api/v1/session", json=account, timeout=ANSWER_SECONDS_MAX)
    except httpx.HTTPError:
        return httpx.Response(503)


def release(name: str, chart_digest: str) -> dict[str, Any]:
    """A release as its file on main has it."""
    annotations = {
        "robotkube.io/plan": "20261124-100000-abcdef",
        "robotkube.io/chart": "event-detector",
        "robotkube.io/chart-digest": chart_digest,
    }
    values = {"placement": {"agent": "vehicle-00"}}
    metadata = {"name": name, "namespace": "vehicle-00", "annotations": annotations}
    return {"metadata": metadata, "spec": {"values": values}}


def test_releases_become_applications_under_admission_and_others_do_not(
    installed: Cluster, controller: str, embedded: Rendered
) -> None:
    """By the ApplicationSet of the platform chart, with releases given in place of those in Git; `controller` writes
    with its own account."""
    [project] = embedded.of_kind("AppProject")
    [generated] = copy.deepcopy(embedded.of_kind("ApplicationSet"))
    elements = [release("detector", CHART), release("stranger", digest(8))]
    generated["spec"]["generators"] = [{"list": {"elements": elements}}]
    installed.kubectl("apply", "-n", NAMESPACE, "-f", "-", text=yaml.safe_dump_all([project, generated]))

    def said() -> str:
        return (installed.kubeconfig.parent / "argocd-applicationset-controller.log").read_text()

    until(lambda: "Application vehicle-00-stranger is of" in said(), "the stranger refused")
    listed = installed.kubectl("get", "applications", "-n", NAMESPACE, "-o", "name").split()
    assert listed == ["application.argoproj.io/vehicle-00-detector"]


def test_there_is_no_administrator_who_could_log_in(installed: Cluster, server: str) -> None:
    """Without the account the server makes no initial password."""
    listed = json.loads(installed.kubectl("get", "secrets", "-n", NAMESPACE, "-o", "json"))["items"]
    secrets = {one["metadata"]["name"]: one.get("data", {}) for one in listed}
    assert "server.secretkey" in secrets["argocd-secret"]
    assert "argocd-initial-admin-secret" not in secrets
    assert "admin.password" not in secrets["argocd-secret"]
    assert log_in(server, "admin", "any").status_code == 401
    assert log_in(server, SETUP.account, SETUP.password).status_code == 200


@pytest.mark.parametrize("forge", HOOKS)
@pytest.mark.parametrize("process", ["server", "controller"])
def test_an_unsigned_hook_of_no_forge_is_taken(request: pytest.FixtureRequest, process: str, forge: str) -> None:
    refused = send(request.getfixturevalue(process), *HOOKS[forge])
    assert refused.status_code in (400, 401), refused.text
    if forge == "gitlab":
        shown("elsewhere", refused.text, "hook-unsigned")


@pytest.mark.parametrize("process", ["server", "controller"])
def test_the_hook_that_the_gate_signs_is_taken(request: pytest.FixtureRequest, process: str) -> None:
    url = request.getfixturevalue(process)
    assert send(url, *HOOKS["github"], secret=SETUP.hook_secret).status_code == 200
    assert send(url, *HOOKS["github"], secret="another").status_code == 400  # noqa: S106


@pytest.fixture(scope="module")
def certificate(installed: Cluster, folder: Path) -> Path:
    """The folder with what the installer made for clients of the repo-server."""
    secret = json.loads(installed.kubectl("get", "secret", "argocd-repo-server-mtls", "-n", NAMESPACE, "-o", "json"))
    for name, value in secret["data"].items():
        (folder / name).write_bytes(base64.b64decode(value))
    return folder


def test_the_repo_server_answers_who_shows_the_certificate_and_nobody_else(
    installed: Cluster, certificate: Path
) -> None:
    with rendering(installed, certificate, certificate / "client-ca.crt") as port:
        nobody, known, other = (ssl.create_default_context() for _ in range(3))
        known.load_cert_chain(certificate / "client.crt", certificate / "client.key")
        own = client_certificate("argocd")
        (certificate / "own.pem").write_text(own.certificate + own.key)
        other.load_cert_chain(certificate / "own.pem")
        until(lambda: greeting(port, known) != "", "the repo-server listens")
        assert greeting(port, known) == "answered"
        shown("elsewhere", greeting(port, nobody), "repo-server-asked")
        assert greeting(port, other) == "TLSV1_ALERT_UNKNOWN_CA"


def greeting(port: int, context: ssl.SSLContext) -> str:
    """What comes of a greeting in HTTP/2: answered, or why not; empty while nobody listens."""
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    context.set_alpn_protocols(["h2"])
    try:
        with (
            socket.create_connection(("127.0.0.1", port), timeout=ANSWER_SECONDS_MAX) as plain,
            context.wrap_socket(plain) as connection,
        ):
            connection.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0]))
            return "answered" if connection.recv(9) else "closed"
    except ConnectionRefusedError:
        return ""
    except ssl.SSLError as error:
        return error.reason


def test_installing_again_keeps_the_certificate(installed: Cluster, folder: Path, certificate: Path) -> None:
    Installer(Path(program("kubectl")).parent, installed.kubeconfig, folder).repo_server_clients()
    secret = json.loads(installed.kubectl("get", "secret", "argocd-repo-server-mtls", "-n", NAMESPACE, "-o", "json"))
    assert base64.b64decode(secret["data"]["client.crt"]) == (certificate / "client.crt").read_bytes()
