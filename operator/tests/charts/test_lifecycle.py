"""Install, upgrade, uninstall and install again, on a real API server without nodes.

Besides: what the API server makes of the definition of tasks, and of everyone's rights.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.foundation.kubernetes.core.network_policies import read_policy
from tests.stages.kubernetes.installed_chart import CHART, Cluster, prepared_cluster

pytestmark = pytest.mark.toolchain

LOADER = yaml.CSafeLoader
KEPT = [
    ("Secret", "robotkube-seed"),
    ("Namespace", "robotkube-gate"),
    ("Lease", "robotkube-manager-manager"),
    ("Namespace", "robotkube-suite-0"),
    ("CustomResourceDefinition", "taskdescriptions.robotkube.io"),
    ("PersistentVolumeClaim", "forge"),
    ("PersistentVolumeClaim", "database"),
    ("Namespace", "vehicle-00"),
    ("Namespace", "cloud-0"),
]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with prepared_cluster(tmp_path_factory.mktemp("api")) as prepared:
        yield prepared


@pytest.fixture(scope="module")
def values(helm: Any) -> Path:
    """The official profile without a seed, and with claims for every agent, so that every namespace stays."""
    profile = yaml.safe_load((Path(__file__).parent / "profiles" / "official.yaml").read_text())
    del profile["secrets"]
    profile["agents"] = [agent for agent in profile["agents"] if agent.get("records") or agent.get("claims")]
    return Path(helm.values(profile))


@pytest.fixture(scope="module")
def older(cluster: Cluster, values: Path, charts_before: Path) -> dict[str, Any]:
    """The platform of the commit before, installed without its Jobs: nothing here runs pods. What must not change."""
    cluster.helm("install", "robotkube", str(charts_before / "robotkube"), "-f", str(values), "--no-hooks")
    return selectors(cluster)


@pytest.fixture(scope="module")
def installed(cluster: Cluster, values: Path, older: dict[str, Any]) -> Cluster:
    """That platform, upgraded to the present chart."""
    cluster.helm("upgrade", "robotkube", str(CHART), "-f", str(values), "--no-hooks")
    return cluster


def selectors(cluster: Cluster) -> dict[str, Any]:
    """UID and selector of every workload, by kind, namespace and name: what was made anew has another UID."""
    workloads = json.loads(cluster.kubectl("get", "deployments,statefulsets", "-A", "-o", "json"))["items"]
    return {
        f"{workload['kind']} {workload['metadata']['namespace']}/{workload['metadata']['name']}": (
            workload["metadata"]["uid"],
            workload["spec"]["selector"],
        )
        for workload in workloads
    }


def test_an_upgrade_from_the_commit_before_makes_no_workload_anew(installed: Cluster, older: dict[str, Any]) -> None:
    assert len(older) >= 6
    now = selectors(installed)
    stays = {name: one for name, one in older.items() if name != "Deployment robotkube/gate"}  # decision 0040
    assert {name: now.get(name) for name in stays} == stays
    assert {name for name in now if name.endswith("/gate")} == {"Deployment robotkube-gate/gate"}


def test_the_key_that_the_chart_before_made_is_there_to_be_moved(installed: Cluster, charts_before: Path) -> None:
    if (charts_before / "robotkube" / "templates" / "evidence" / "secret.yaml").exists():
        assert installed.kubectl("get", "secret", "gate-key", "-o", "name")


def test_the_api_server_has_the_network_policies_as_they_were_meant(
    installed: Cluster, helm: Any, values: Path
) -> None:
    policies = json.loads(installed.kubectl("get", "networkpolicies", "--all-namespaces", "-o", "json"))["items"]
    meant = helm.template(CHART, values).of_kind("NetworkPolicy")
    assert {(one.namespace, one.name): one for one in map(read_policy, policies)} == {
        (one.namespace, one.name): one for one in map(read_policy, meant)
    }


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
    assert row[0].split() == ["NAME", "APPLICATION", "PRIORITY", "ACCEPTED", "REASON", "READY", "AGE"]
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


ACCOUNTS = [
    *(f"robotkube:{name}" for name in ("manager", "suite-runner", "bootstrap", "teardown", "gate-key", "default")),
    *(f"robotkube-gate:{name}" for name in ("gate", "default")),
    *(f"robotkube-suite-0:{name}" for name in ("application", "mqtt-bridge", "default")),
    *(f"cloud-0:{name}" for name in ("application", "event-detector")),
]


def test_nobody_may_read_the_key_of_the_gate_after_an_upgrade(installed: Cluster) -> None:
    """All accounts of an installation, and every verb: charts/test_rights.py."""
    key = {"namespace": "robotkube-gate", "resource": "secrets", "name": "gate-key"}

    def review(account: str, verb: str) -> dict[str, Any]:
        groups = ["serviceaccounts", f"serviceaccounts:{account.partition(':')[0]}", "authenticated"]
        who = {"user": f"system:serviceaccount:{account}", "groups": [f"system:{name}" for name in groups]}
        spec = {**who, "resourceAttributes": {**key, "verb": verb}}
        return {"apiVersion": "authorization.k8s.io/v1", "kind": "SubjectAccessReview", "spec": spec}

    reviews = [review(account, verb) for account in ACCOUNTS for verb in ("get", "list", "watch")]
    asked = {"apiVersion": "v1", "kind": "List", "items": reviews}
    allowed = ("create", "--validate=false", "-o", r"jsonpath={.status.allowed}{'\n'}", "-f", "-")
    assert installed.kubectl(*allowed, text=json.dumps(asked)).split() == ["false"] * len(reviews)


def test_an_upgrade_keeps_every_password_and_task_and_upgrades_their_definition(
    installed: Cluster, values: Path
) -> None:
    before = installed.helm("get", "manifest", "robotkube")
    password = installed.password("cloud-0", "database-account")
    patch = '{"metadata":{"labels":{"app.kubernetes.io/version":"0.0.1"}},"spec":{"names":{"shortNames":["old"]}}}'
    name = "crd/taskdescriptions.robotkube.io"
    installed.kubectl("patch", name, "--type=merge", "-p", patch)
    installed.helm("upgrade", "robotkube", str(CHART), "-f", str(values), "--no-hooks")
    assert installed.kubectl("get", name, "-o", "jsonpath={.spec.names.shortNames[0]}") == "task"
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
