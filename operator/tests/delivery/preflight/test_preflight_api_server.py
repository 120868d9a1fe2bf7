"""The whole command on a real API server: for an administrator, for an account with few rights, and for one that has
the rights that the check names and no others, with which Helm installs the chart."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from robotkube.cli.main import EXIT_REFUSED, EXIT_UNPROVED, main
from robotkube.delivery.preflight import facts as preflight_facts
from robotkube.delivery.preflight.core.findings import FAILED, NOT_CHECKED, OK
from robotkube.delivery.preflight.core.renderings import OF_THE_CLUSTER, plural
from robotkube.delivery.preflight.core.rights import RBAC, needed_rights
from tests.stages.delivery.preflight.preflight_facts import AGENTS, DEFAULT_CLASS, argo_cd, node, rendering
from tests.stages.kubernetes.installed_chart import CHART, Cluster, prepared_cluster
from tests.stages.paths import REPOSITORY
from tests.stages.programs import program

pytestmark = pytest.mark.toolchain

PATIENCE_SECONDS = 60.0  # other tests may take the processor; the command's own bound: tests/cli/test_preflight.py
PROFILE = REPOSITORY / "operator/tests/charts/profiles/official.yaml"
FORGE = "forge.robotkube.svc.cluster.local:3000"
ROLES = f"/apis/{RBAC}/v1/clusterroles"
Checks = Mapping[str, Mapping[str, Any]]
Run = Callable[..., tuple[int, Checks]]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Argo CD, a StorageClass, and a Node for each agent of the profile."""
    with prepared_cluster(tmp_path_factory.mktemp("api")) as made, made.client() as client:
        storage_class = {"metadata": DEFAULT_CLASS, "provisioner": "example.com/disks"}
        client.post("/apis/storage.k8s.io/v1/storageclasses", json=storage_class).raise_for_status()
        for name, role in AGENTS.items():
            status_of(client, "/api/v1/nodes", node(name, role))
        for workload in argo_cd().workloads:
            status_of(client, "/apis/apps/v1/namespaces/argocd/deployments", deployment(workload))
        parameters = {"metadata": {"name": "argocd-cmd-params-cm"}, "data": {"server.insecure": "true"}}
        client.post("/api/v1/namespaces/argocd/configmaps", json=parameters).raise_for_status()
        ports = [{"name": name, "port": port} for name, port in (("http", 80), ("https", 443))]
        service = {"metadata": {"name": "argocd-server"}, "spec": {"ports": ports}}
        client.post("/api/v1/namespaces/argocd/services", json=service).raise_for_status()
        yield made


def status_of(client: httpx.Client, path: str, item: Mapping[str, Any]) -> None:
    """Make an object that has this status."""
    client.post(path, json=dict(item)).raise_for_status()
    where = f"{path}/{item['metadata']['name']}/status"
    kind = {"Content-Type": "application/merge-patch+json"}
    client.patch(where, content=json.dumps({"status": item["status"]}), headers=kind).raise_for_status()


def deployment(workload: Mapping[str, Any]) -> Mapping[str, Any]:
    """A part of Argo CD, complete."""
    name, labels = workload["metadata"]["name"], workload["metadata"]["labels"]
    metadata = {"name": name, "labels": {**labels, "app.kubernetes.io/part-of": "argocd"}}
    template = {**workload["spec"]["template"], "metadata": {"labels": labels}}
    spec = {"selector": {"matchLabels": labels}, "template": template}
    return {"metadata": metadata, "spec": spec, "status": {"replicas": 1, "readyReplicas": 1}}


@pytest.fixture
def run(cluster: Cluster, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs the command; its exit code, and its checks by name."""
    monkeypatch.setenv("ROBOTKUBE_HELM", program("helm"))
    for bound in ("SECONDS_MAX", "RENDERING_SECONDS_MAX"):
        monkeypatch.setattr(preflight_facts, bound, PATIENCE_SECONDS)
    values = yaml.safe_load(PROFILE.read_text(encoding="utf-8"))
    values["images"] |= {
        name: f"{FORGE}/robotkube/{name}@sha256:{'1' * 64}" for name in ("mosquitto", "gitea", "mongo")
    }
    values["images"] = {name: text.replace("registry.example", FORGE) for name, text in values["images"].items()}
    (tmp_path / "values.yaml").write_text(yaml.safe_dump(values))

    def command(kubeconfig: Path = cluster.kubeconfig, *more: str) -> tuple[int, Checks]:
        words = ["preflight", "--kubeconfig", str(kubeconfig), "--chart", str(CHART), "--output", "json"]
        code = main([*words, *(more or ("--values", str(tmp_path / "values.yaml")))])
        text = capsys.readouterr().out
        assert values["secrets"]["seed"] not in text
        return code, {one["check"]: one for one in json.loads(text)["checks"]}

    return command


def account(cluster: Cluster, name: str, rules: Any) -> Path:
    """A kubeconfig of a service account with these rights in the whole cluster."""
    with cluster.client() as client:
        accounts = "/api/v1/namespaces/default/serviceaccounts"
        client.post(accounts, json={"metadata": {"name": name}}).raise_for_status()
        client.post(ROLES, json={"metadata": {"name": name}, "rules": rules}).raise_for_status()
        reference = {"apiGroup": RBAC, "kind": "ClusterRole", "name": name}
        subjects = [{"kind": "ServiceAccount", "name": name, "namespace": "default"}]
        binding = {"metadata": {"name": name}, "roleRef": reference, "subjects": subjects}
        client.post(f"/apis/{RBAC}/v1/clusterrolebindings", json=binding).raise_for_status()
        token = client.post(f"{accounts}/{name}/token", json={"spec": {}}).raise_for_status().json()["status"]["token"]
    document = yaml.safe_load(cluster.kubeconfig.read_text())
    document["users"][0]["user"] = {"token": token}
    path = cluster.kubeconfig.with_name(f"kubeconfig-{name}")
    path.write_text(yaml.safe_dump(document))
    return path


def test_an_administrator_sees_what_is_there(run: Run) -> None:
    code, checks = run()
    unknown = {name: one["says"] for name, one in checks.items() if one["result"] != OK}
    assert code == EXIT_UNPROVED
    assert set(unknown) == {"control-groups", "registries"}, unknown
    assert "version of cloud-0, vehicle-00, vehicle-01 not read" in unknown["control-groups"], "there is no kubelet"
    assert "the platform's own, which the chart makes" in unknown["registries"]


def test_an_argo_cd_that_redirects_is_named_and_its_certificate_mends_it(
    cluster: Cluster, run: Run, tmp_path: Path
) -> None:
    path, kind = "/api/v1/namespaces/argocd/configmaps/argocd-cmd-params-cm", "application/merge-patch+json"
    values = tmp_path / "values.yaml"
    given = {"argocd": {"server": {"authorities": "-----BEGIN CERTIFICATE-----\nMII=\n-----END CERTIFICATE-----\n"}}}
    with cluster.client() as client:
        for insecure in (None, "true"):  # as its own manifests have it; and back
            patch = json.dumps({"data": {"server.insecure": insecure}})
            client.patch(path, content=patch, headers={"Content-Type": kind}).raise_for_status()
            if insecure:
                continue
            _, checks = run()
            assert checks["argocd"]["result"] == FAILED
            assert checks["argocd"]["problems"][0]["what"].startswith("it redirects to HTTPS, and managers ask http://")
            values.write_text(yaml.safe_dump(yaml.safe_load(values.read_text()) | given))
            _, checks = run()
            assert (checks["argocd"]["result"], checks["values"]["result"]) == (OK, OK), checks["argocd"]


def test_the_resources_of_kinds_are_those_that_are_served(cluster: Cluster) -> None:
    objects = [*rendering().objects, *rendering("embedded").objects]
    with cluster.client() as client:
        for version, kind in sorted({(item["apiVersion"], item["kind"]) for item in objects}):
            path = f"/apis/{version}" if "/" in version else f"/api/{version}"
            served = {one["name"]: one for one in client.get(path).json()["resources"]}
            one = served[plural(kind)]
            assert (one["kind"], one["namespaced"]) == (kind, kind not in OF_THE_CLUSTER)


def test_an_account_with_few_rights_learns_which_are_missing(cluster: Cluster, run: Run) -> None:
    rules = [
        {"verbs": ["get", "list"], "apiGroups": [""], "resources": ["namespaces", "secrets", "services"]},
        {"verbs": ["*"], "apiGroups": ["apps"], "resources": ["deployments"]},
    ]
    code, checks = run(account(cluster, "few", rules))
    assert code == EXIT_REFUSED
    assert (checks["values"]["result"], checks["version"]["result"], checks["kinds"]["result"]) == (OK, OK, OK)
    missing = {one["what"]: one["where"] for one in checks["rights"]["problems"]}
    assert checks["rights"]["result"] == FAILED
    assert missing["may not create, delete, patch namespaces"] == "the whole cluster"
    assert "robotkube-suite-0" in missing["may not create, delete, get, patch resourcequotas"]
    assert not [what for what in missing if "deployments.apps" in what], "it may do all of this"
    assert "may not give get of nodes/stats" in missing
    assert checks["capacity"]["result"] == NOT_CHECKED
    assert "nodes is forbidden" in checks["capacity"]["says"]


def test_helm_installs_the_chart_with_the_rights_that_are_named(cluster: Cluster, run: Run, tmp_path: Path) -> None:
    needed = needed_rights(rendering())
    verbs: defaultdict[tuple[str, str, str], set[str]] = defaultdict(set)
    for right in needed.own.union(*needed.given.values()):
        verbs[right.group, right.resource, right.name].add(right.verb)
    rules = [
        {
            "verbs": sorted(allowed),
            "apiGroups": [group],
            "resources": [resource],
            "resourceNames": [name] if name else [],
        }
        for (group, resource, name), allowed in verbs.items()
    ]
    kubeconfig = account(cluster, "installer", rules)
    _, checks = run(kubeconfig)
    assert checks["rights"]["result"] == OK, checks["rights"]
    installer = Cluster(kubeconfig)
    installer.helm("install", "robotkube", str(CHART), "--values", str(tmp_path / "values.yaml"), "--no-hooks")
    code, checks = run(cluster.kubeconfig, "--release", "robotkube")
    unknown = {name for name, one in checks.items() if one["result"] != OK}
    assert (code, unknown) == (EXIT_UNPROVED, {"control-groups", "registries"}), [checks[name] for name in unknown]
    assert "revision 1 of robotkube is deployed" in checks["release"]["says"]
    assert "values of the release that is there; 3 agents" in checks["values"]["says"]
