"""Install, upgrade, uninstall and install again, on a real API server without nodes.

Besides: what the API server makes of the definition of tasks, and of everyone's rights.
"""

from __future__ import annotations

import base64
import json
import os
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from api_server import ApiServerProcess
from programs import program

from ci import toolchain

SERVED_SECONDS_MAX = 60.0
LOADER = yaml.CSafeLoader
CALL_SECONDS_MAX = 120
CHART = Path(__file__).resolve().parents[3] / "charts" / "robotkube"
KEPT = [
    ("Secret", "robotkube-seed"),
    ("Secret", "gate-key"),
    ("Namespace", "robotkube-suite-0"),
    ("CustomResourceDefinition", "taskdescriptions.robotkube.io"),
    ("PersistentVolumeClaim", "forge"),
    ("PersistentVolumeClaim", "database"),
    ("Namespace", "vehicle-00"),
    ("Namespace", "cloud-0"),
]


@dataclass(frozen=True)
class Cluster:
    """An API server, and the programs to talk to it."""

    kubeconfig: Path

    def run(self, name: str, *arguments: str, text: str | None = None) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "KUBECONFIG": str(self.kubeconfig), "HOME": str(self.kubeconfig.parent)}
        command = [program(name), *arguments]
        return subprocess.run(
            command, input=text, capture_output=True, text=True, timeout=CALL_SECONDS_MAX, check=False, env=environment
        )

    def kubectl(self, *arguments: str, text: str | None = None) -> str:
        done = self.run("kubectl", "-n", "robotkube", *arguments, text=text)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def helm(self, *arguments: str) -> str:
        done = self.run("helm", "-n", "robotkube", *arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def password(self, namespace: str, name: str) -> str:
        secret = json.loads(self.kubectl("get", "secret", name, "-n", namespace, "-o", "json"))
        return base64.b64decode(secret["data"]["password"]).decode()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    server = ApiServerProcess(tmp_path_factory.mktemp("api"))
    try:
        server.start()
        found = Cluster(server.kubeconfig)
        prepare(found)
        yield found
    finally:
        server.stop()


def prepare(cluster: Cluster) -> None:
    """What is there before the platform: Argo CD's definitions, and the namespaces."""
    manifests = toolchain.module_dir("github.com/argoproj/argo-cd/v3") / "manifests" / "crds"
    names = ("application-crd.yaml", "applicationset-crd.yaml", "appproject-crd.yaml")
    files = [option for name in names for option in ("-f", str(manifests / name))]
    for namespace in ("robotkube", "argocd"):
        cluster.kubectl("create", "namespace", namespace)
    cluster.kubectl("apply", "--server-side", *files)
    deadline = time.monotonic() + SERVED_SECONDS_MAX
    while cluster.run("kubectl", "get", "applications,applicationsets,appprojects").returncode:
        assert time.monotonic() < deadline, "Argo CD's definitions are not served"
        time.sleep(0.2)


@pytest.fixture(scope="module")
def values(helm: Any) -> Path:
    """The official profile without a seed, and with claims for every agent, so that every namespace stays."""
    profile = yaml.safe_load((Path(__file__).parent / "profiles" / "official.yaml").read_text())
    del profile["secrets"]
    profile["agents"] = [agent for agent in profile["agents"] if agent.get("records") or agent.get("claims")]
    return Path(helm.values(profile))


@pytest.fixture(scope="module")
def installed(cluster: Cluster, values: Path) -> Cluster:
    """The platform, installed without its Jobs: nothing here runs pods."""
    cluster.helm("install", "robotkube", str(CHART), "-f", str(values), "--no-hooks")
    return cluster


def task(**spec: Any) -> str:
    event = {"rule": "r", "id": "1", "time": "2026-11-21T10:00:00.123456Z", "trace": "0" * 32}
    document = {
        "apiVersion": "robotkube.io/v1alpha1",
        "kind": "TaskDescription",
        "metadata": {"name": "t", "namespace": "cloud-0"},
        "spec": {
            "requester": "cloud-0/event-detector",
            "event": event,
            "application": "recording",
            "parameters": {"vehicles": ["vehicle-00"], "deep": {"er": 1}},
            **spec,
        },
    }
    return yaml.safe_dump(document)


def test_the_api_server_takes_every_object(installed: Cluster) -> None:
    listed = installed.helm("get", "manifest", "robotkube")
    count = len([document for document in yaml.load_all(listed, Loader=LOADER) if document])
    assert count > 60
    assert "robotkube-apps" in installed.kubectl("get", "appprojects", "-n", "argocd", "-o", "name")


def test_a_task_is_kept_as_written(installed: Cluster) -> None:
    installed.kubectl("create", "-n", "cloud-0", "-f", "-", text=task())
    kept = json.loads(installed.kubectl("get", "task", "t", "-n", "cloud-0", "-o", "json"))
    assert kept["spec"]["parameters"] == {"vehicles": ["vehicle-00"], "deep": {"er": 1}}
    status = {"status": {"conditions": [{"type": "Ready", "status": "False", "reason": "Waiting", "message": "m"}]}}
    status["status"]["conditions"][0]["lastTransitionTime"] = "2026-11-21T10:00:00Z"
    patch = ("patch", "task", "t", "-n", "cloud-0", "--subresource=status", "--type=merge", "-p", json.dumps(status))
    installed.kubectl(*patch)
    row = installed.kubectl("get", "tasks", "-n", "cloud-0").splitlines()
    assert row[0].split() == ["NAME", "APPLICATION", "ACCEPTED", "READY", "AGE"]
    assert "False" in row[1]


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"urgent": True}, 'unknown field "spec.urgent"'),
        ({"requester": ""}, "spec.requester"),
        ({"event": {"rule": "r", "id": "1", "time": "2026-11-21T10:00:00Z"}}, "spec.event.trace: Required value"),
        (
            {"event": {"rule": "r", "id": "1", "time": "yesterday", "trace": "0" * 32}},
            "spec.event.time",
        ),
        ({"event": {"rule": "r", "id": "1", "time": "2026-11-21T10:00:00Z", "trace": "x"}}, "spec.event.trace"),
        ({"application": "x" * 64}, "spec.application"),
    ],
)
def test_the_api_server_refuses_a_bad_task(installed: Cluster, spec: dict[str, Any], message: str) -> None:
    done = installed.run("kubectl", "create", "--validate=strict", "-f", "-", text=task(**spec))
    assert done.returncode != 0
    assert message in done.stderr


FORBIDDEN = [
    *(f"{verb} {kind}" for verb in ("create", "update", "patch", "delete") for kind in ("pods", "deployments.apps")),
    *(f"{verb} secrets" for verb in ("get", "list", "create", "update", "patch", "delete")),
    "create pods --subresource=exec",
    "create serviceaccounts --subresource=token",
    *(f"{verb} {kind}" for verb in ("create", "bind", "escalate") for kind in ("roles", "clusterroles")),
    "create rolebindings",
    "impersonate users",
    "impersonate serviceaccounts",
    *(
        f"{verb} {kind}.argoproj.io"
        for verb in ("create", "update", "patch", "delete")
        for kind in ("applications", "applicationsets", "appprojects")
    ),
    *(f"{verb} taskdescriptions.robotkube.io" for verb in ("create", "update", "patch", "delete")),
    "create namespaces",
    "patch nodes",
]
ALLOWED = [
    "watch taskdescriptions.robotkube.io",
    "patch taskdescriptions.robotkube.io --subresource=status",
    "list nodes",
    "watch pods",
    "list applications.argoproj.io -n argocd",
    "create events.events.k8s.io -n cloud-0",
]


@pytest.mark.parametrize("namespace", ["robotkube", "argocd", "cloud-0"])
def test_the_manager_may_not_write(installed: Cluster, namespace: str) -> None:
    account = "--as=system:serviceaccount:robotkube:manager"
    answers = {
        question: installed.run("kubectl", "auth", "can-i", *question.split(), "-n", namespace, account).stdout.strip()
        for question in FORBIDDEN
    }
    assert {question for question, answer in answers.items() if answer != "no"} == set()


@pytest.mark.parametrize("question", ALLOWED)
def test_the_manager_may_read_and_report(installed: Cluster, question: str) -> None:
    account = "--as=system:serviceaccount:robotkube:manager"
    assert installed.run("kubectl", "auth", "can-i", *question.split(), account).stdout.strip() == "yes"


@pytest.mark.parametrize(
    ("account", "question", "answer"),
    [
        ("cloud-0:event-detector", "create taskdescriptions.robotkube.io -n cloud-0", "yes"),
        ("cloud-0:event-detector", "watch configmaps -n cloud-0", "yes"),
        ("cloud-0:event-detector", "create taskdescriptions.robotkube.io -n vehicle-00", "no"),
        ("cloud-0:event-detector", "patch taskdescriptions.robotkube.io --subresource=status -n cloud-0", "no"),
        ("cloud-0:event-detector", "get secrets -n cloud-0", "no"),
        ("vehicle-00:mqtt-bridge", "watch configmaps -n vehicle-00", "yes"),
        ("vehicle-00:mqtt-bridge", "watch configmaps -n cloud-0", "no"),
        ("vehicle-00:mqtt-bridge", "create taskdescriptions.robotkube.io -n vehicle-00", "no"),
        ("vehicle-00:bag-player", "get configmaps -n vehicle-00", "yes"),
        ("robotkube:bootstrap", "patch secrets/argocd-secret -n argocd", "yes"),
        ("robotkube:bootstrap", "patch secrets/argocd-redis -n argocd", "no"),
        ("robotkube:bootstrap", "get secrets -n robotkube", "no"),
        ("robotkube:bootstrap", "patch deployments.apps/argocd-applicationset-controller -n argocd", "yes"),
        ("robotkube:bootstrap", "patch deployments.apps/argocd-server -n argocd", "no"),
        ("robotkube:teardown", "delete applicationsets.argoproj.io/releases -n argocd", "yes"),
        ("robotkube:teardown", "delete applications.argoproj.io -n argocd", "no"),
        ("robotkube:gate", "get configmaps -n robotkube", "no"),
        ("cloud-0:application", "watch configmaps -n cloud-0", "yes"),
        ("robotkube-suite-0:application", "watch configmaps -n robotkube-suite-0", "yes"),
        ("robotkube-suite-0:application", "get secrets -n robotkube-suite-0", "no"),
        ("robotkube:suite-runner", "create deployments.apps -n robotkube-suite-1", "yes"),
        ("robotkube:suite-runner", "create secrets -n robotkube-suite-1", "yes"),
        ("robotkube:suite-runner", "get secrets -n robotkube-suite-1", "no"),
        ("robotkube:suite-runner", "create roles -n robotkube-suite-1", "no"),
        ("robotkube:suite-runner", "create pods --subresource=exec -n robotkube-suite-1", "no"),
        ("robotkube:suite-runner", "create serviceaccounts --subresource=token -n robotkube-suite-1", "no"),
        ("robotkube:suite-runner", "create namespaces", "no"),
        *(("robotkube:suite-runner", f"create pods -n {namespace}", "no") for namespace in ("robotkube", "cloud-0")),
    ],
)
def test_rights_of_the_other_accounts(installed: Cluster, account: str, question: str, answer: str) -> None:
    asked = installed.run("kubectl", "auth", "can-i", *question.split(), f"--as=system:serviceaccount:{account}")
    assert asked.stdout.strip() == answer


ACCOUNTS = [
    *(f"robotkube:{name}" for name in ("gate", "manager", "suite-runner", "bootstrap", "teardown", "default")),
    *(f"robotkube-suite-0:{name}" for name in ("application", "mqtt-bridge", "default")),
    *(f"cloud-0:{name}" for name in ("application", "event-detector")),
    "argocd:argocd-application-controller",
]


@pytest.mark.parametrize("verb", ["get", "list", "watch"])
@pytest.mark.parametrize("account", ACCOUNTS)
def test_nobody_may_read_the_key_of_the_gate(installed: Cluster, account: str, verb: str) -> None:
    question = (verb, "secrets/gate-key", "-n", "robotkube", f"--as=system:serviceaccount:{account}")
    assert installed.run("kubectl", "auth", "can-i", *question).stdout.strip() == "no"


def test_an_upgrade_keeps_every_password_and_task(installed: Cluster, values: Path) -> None:
    before = installed.helm("get", "manifest", "robotkube")
    password = installed.password("cloud-0", "database-account")
    installed.helm("upgrade", "robotkube", str(CHART), "-f", str(values), "--no-hooks")
    assert installed.helm("get", "manifest", "robotkube") == before
    assert installed.password("cloud-0", "database-account") == password
    assert installed.kubectl("get", "tasks", "-n", "cloud-0", "-o", "name").split() == [
        "taskdescription.robotkube.io/t"
    ]


def test_another_seed_is_refused_while_the_old_one_is_kept(installed: Cluster, values: Path) -> None:
    seed = "secrets.seed=another-seed-of-thirty-two-characters"
    done = installed.run(
        "helm", "-n", "robotkube", "upgrade", "robotkube", str(CHART), "-f", str(values), "--set", seed
    )
    assert done.returncode != 0
    assert "secrets.seed differs from the one kept in the Secret robotkube-seed" in done.stderr


def test_an_upgrade_upgrades_the_definition_of_tasks(installed: Cluster, values: Path) -> None:
    patch = '{"metadata":{"labels":{"app.kubernetes.io/version":"0.0.1"}},"spec":{"names":{"shortNames":["old"]}}}'
    name = "crd/taskdescriptions.robotkube.io"
    installed.kubectl("patch", name, "--type=merge", "-p", patch)
    installed.helm("upgrade", "robotkube", str(CHART), "-f", str(values), "--no-hooks")
    assert installed.kubectl("get", name, "-o", "jsonpath={.spec.names.shortNames[0]}") == "task"


def test_uninstall_keeps_what_it_says_and_installing_again_uses_it(installed: Cluster, values: Path) -> None:
    password = installed.password("robotkube", "forge-account-manager")
    said = installed.helm("uninstall", "robotkube", "--no-hooks")
    for kind, name in KEPT:
        assert f"[{kind}] {name}" in said
        installed.kubectl("get", kind, name)
    left = installed.kubectl("get", "deployments,statefulsets,services,appprojects,applicationsets", "-A", "-o", "name")
    assert left.split() == ["service/kubernetes"]
    assert installed.kubectl("get", "tasks", "-n", "cloud-0", "-o", "name")
    installed.helm("install", "robotkube", str(CHART), "-f", str(values), "--no-hooks")
    assert installed.password("robotkube", "forge-account-manager") == password
