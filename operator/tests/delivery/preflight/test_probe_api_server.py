"""`robotkube preflight --probe` on a real API server with its controllers, whose kubelets are a thread that says what
pods are like: what it makes is admitted, and nothing of it stays, also after Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from robotkube.cli.main import EXIT_REFUSED, main
from robotkube.delivery.preflight import facts as preflight_facts
from robotkube.delivery.preflight.core.findings import FAILED, NOT_CHECKED, OK
from tests.stages.delivery.preflight.preflight_facts import AGENTS, node
from tests.stages.delivery.preflight.probed_nodes import answer
from tests.stages.kubernetes.controllers import controlling
from tests.stages.kubernetes.installed_chart import CHART, Cluster, prepared_cluster
from tests.stages.paths import REPOSITORY
from tests.stages.programs import program

pytestmark = pytest.mark.toolchain

PATIENCE_SECONDS = 60.0
PROFILE = REPOSITORY / "operator/tests/charts/profiles/official.yaml"
NAMESPACE = "robotkube-probe"
PODS = f"/api/v1/namespaces/{NAMESPACE}/pods"
MERGE = {"Content-Type": "application/strategic-merge-patch+json"}
State = Callable[[str, str], Mapping[str, Any]]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A Node for each agent of the profile, and the controllers, which take a deleted namespace's objects away."""
    folder = tmp_path_factory.mktemp("api")
    with prepared_cluster(folder) as made, made.client() as client, controlling(folder, made.kubeconfig):
        for name, role in AGENTS.items():
            client.post("/api/v1/nodes", json=node(name, role)).raise_for_status()
            keep_ready(client, name)
        yield made


def keep_ready(client: httpx.Client, name: str) -> None:
    status = {"conditions": node(name)["status"]["conditions"]}
    client.patch(f"/api/v1/nodes/{name}/status", content=json.dumps({"status": status}), headers=MERGE)


def answers(name: str, on: str) -> Mapping[str, Any]:
    """The state of a pod on a cluster on which nothing is wrong."""
    if name.startswith("serve"):
        return {"running": {"startedAt": "2026-01-01T00:00:00Z"}}
    ended = {"startedAt": "2026-01-01T00:00:00Z", "finishedAt": "2026-01-01T00:00:01Z"}
    return {"terminated": {"exitCode": 0, "message": answer().text, **ended}}


@contextmanager
def kubelets(cluster: Cluster, state: State) -> Iterator[list[str]]:
    """Says of every pod of the probe what it is like, and lets go of deleted ones; the names of all pods it saw."""
    ending = threading.Event()
    seen = []

    def work() -> None:
        with cluster.client() as client:
            while not ending.wait(0.05):
                for name in AGENTS:
                    keep_ready(client, name)
                for pod in client.get(PODS).json().get("items") or ():
                    name, on = pod["metadata"]["name"], pod["spec"]["nodeName"]
                    if "deletionTimestamp" in pod["metadata"]:
                        client.request("DELETE", f"{PODS}/{name}", json={"gracePeriodSeconds": 0})
                    elif name not in seen:
                        seen.append(name)
                        client.patch(
                            f"{PODS}/{name}/status", content=json.dumps({"status": status(name, on)}), headers=MERGE
                        )

    def status(name: str, on: str) -> Mapping[str, Any]:
        outcome = state(name, on)
        container = {"name": "probe", "image": "x", "imageID": "", "ready": False, "restartCount": 0, "state": outcome}
        phase = "Running" if "running" in outcome else "Succeeded" if "terminated" in outcome else "Pending"
        address = {"podIP": "10.0.0.1", "podIPs": [{"ip": "10.0.0.1"}]}
        return {"phase": phase, "containerStatuses": [container], **address}

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield seen
    finally:
        ending.set()
        thread.join()


@pytest.fixture
def run(cluster: Cluster, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Any:
    """Runs the command; its exit code, its checks by name, and what it said besides."""
    monkeypatch.setenv("ROBOTKUBE_HELM", program("helm"))
    for bound in ("SECONDS_MAX", "RENDERING_SECONDS_MAX"):
        monkeypatch.setattr(preflight_facts, bound, PATIENCE_SECONDS)
    values = yaml.safe_load(PROFILE.read_text(encoding="utf-8"))
    (tmp_path / "values.yaml").write_text(yaml.safe_dump(values))

    def command(kubeconfig: Path = cluster.kubeconfig) -> tuple[int, Mapping[str, Any], str]:
        words = ["preflight", "--probe", "--kubeconfig", str(kubeconfig), "--chart", str(CHART), "--output", "json"]
        code = main([*words, "--values", str(tmp_path / "values.yaml")])
        out, err = capsys.readouterr()
        return code, {one["check"]: one for one in json.loads(out)["checks"]} if out else {}, err

    return command


def is_gone(cluster: Cluster) -> bool:
    with cluster.client() as client:
        return bool(client.get(f"/api/v1/namespaces/{NAMESPACE}").status_code == httpx.codes.NOT_FOUND)


def test_pods_answer_on_each_node_and_are_gone_again(cluster: Cluster, run: Any) -> None:
    with kubelets(cluster, answers) as seen:
        began = time.monotonic()
        _, checks, err = run()
        assert time.monotonic() - began < PATIENCE_SECONDS
    probe = {
        name: checks[name]["result"] for name in ("pull", "disks", "names", "clocks", "network-policies", "removed")
    }
    assert probe == dict.fromkeys(probe, OK), checks
    assert (checks["broker"]["result"], "absent" in checks["broker"]["says"]) == (NOT_CHECKED, True)
    assert sorted(seen) == [*(f"ask-{number}" for number in range(3)), *(f"serve-{number}" for number in range(3))]
    assert is_gone(cluster)
    assert "pods start on 3 Nodes, in namespace robotkube-probe" in err


@pytest.mark.thorough
def test_a_node_without_the_image_is_named(cluster: Cluster, run: Any) -> None:
    def state(name: str, on: str) -> Mapping[str, Any]:
        missing = {"waiting": {"reason": "ImagePullBackOff", "message": "registry.example: no such host"}}
        return missing if on == "vehicle-00" else answers(name, on)

    with kubelets(cluster, state):
        code, checks, _ = run()
    [problem] = checks["pull"]["problems"]
    assert (code, checks["pull"]["result"], problem["where"]) == (EXIT_REFUSED, FAILED, "Node vehicle-00")
    assert "registry.example: no such host" in problem["what"]
    assert is_gone(cluster)


def test_nothing_stays_after_an_interrupt(cluster: Cluster, run: Any) -> None:
    def state(name: str, on: str) -> Mapping[str, Any]:
        os.kill(os.getpid(), signal.SIGINT)
        return answers(name, on)

    with kubelets(cluster, state):
        code, checks, err = run()
    assert (code, checks) == (EXIT_REFUSED, {})
    assert "interrupted" in err
    assert is_gone(cluster)


def test_an_account_with_few_rights_makes_nothing(cluster: Cluster, run: Any, tmp_path: Path) -> None:
    rules = [{"verbs": ["get", "list"], "apiGroups": ["*"], "resources": ["*"]}]
    with cluster.client() as client:
        rbac = "rbac.authorization.k8s.io"
        client.post("/api/v1/namespaces/default/serviceaccounts", json={"metadata": {"name": "reader"}})
        client.post(f"/apis/{rbac}/v1/clusterroles", json={"metadata": {"name": "reader"}, "rules": rules})
        binding = {
            "metadata": {"name": "reader"},
            "roleRef": {"apiGroup": rbac, "kind": "ClusterRole", "name": "reader"},
            "subjects": [{"kind": "ServiceAccount", "name": "reader", "namespace": "default"}],
        }
        client.post(f"/apis/{rbac}/v1/clusterrolebindings", json=binding).raise_for_status()
        made = client.post("/api/v1/namespaces/default/serviceaccounts/reader/token", json={"spec": {}})
    document = yaml.safe_load(cluster.kubeconfig.read_text())
    document["users"][0]["user"] = {"token": made.raise_for_status().json()["status"]["token"]}
    (tmp_path / "kubeconfig").write_text(yaml.safe_dump(document))
    _, checks, _ = run(tmp_path / "kubeconfig")
    assert checks["disks"]["result"] == NOT_CHECKED
    assert "nothing was started: the account may not create namespaces in the cluster" in checks["disks"]["says"]
    assert is_gone(cluster)


def test_a_namespace_of_another_probe_is_left_alone(cluster: Cluster, run: Any) -> None:
    """The last one: the namespace stays."""
    with cluster.client() as client:
        client.post("/api/v1/namespaces", json={"metadata": {"name": NAMESPACE}}).raise_for_status()
    _, checks, _ = run()
    assert checks["pull"]["result"] == NOT_CHECKED
    assert "is there already: another probe is at work, or one was killed" in checks["pull"]["says"]
    assert not is_gone(cluster)
