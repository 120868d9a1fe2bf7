"""What an installation adds to a cluster of others, on a real API server with Kubernetes' controllers: all of it goes,
every object of others is as before, and so is their Argo CD."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from ci.cluster.existing import registry
from ci.cluster.existing.nodes import GivenCluster
from ci.cluster.existing.provider import Existing
from ci.cluster_contract.topology import NodeSpec, Topology
from ci.errors import InputError, SetUpError
from ci.images.services import SERVICE_NAMES
from ci.installation import PLATFORM_IMAGES, Installer
from tests.stages.kubernetes import argocd_definitions
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.kubernetes.controllers import controlling
from tests.stages.paths import CHARTS
from tests.stages.programs import folder as programs
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain, pytest.mark.thorough]

CHART = str(CHARTS / "robotkube")
IMAGES = ("argocd", "redis", *PLATFORM_IMAGES, *SERVICE_NAMES)
REFERENCES = {name: f"forge.example:3000/robotkube/{name}@sha256:{'0' * 64}" for name in IMAGES}
AGENTS = {
    "machine-1": ("platform", "platform"),
    "machine-2": ("cloud", "cloud-0"),
    "machine-3": ("vehicle", "vehicle-00"),
}
TOPOLOGY = Topology(tuple(NodeSpec(agent, role, agent, 1000, 1 << 30, ()) for role, agent in AGENTS.values()))
SERVICE_ADDRESSES = "/apis/networking.k8s.io/v1/servicecidrs/kubernetes"
PARTS = ("application-controller", "applicationset-controller", "repo-server", "server")
MERGE = {"Content-Type": "application/merge-patch+json"}
READY = {"phase": "Running", "conditions": [{"type": "Ready", "status": "True"}]}
ENDED = {"phase": "Succeeded"}
PASSING = {"leases", "events", "endpointslices", "endpoints", "serviceaccounts", "pods", "replicasets"}
CHANGING = ("resourceVersion", "managedFields", "generation")
REVISION = "deployment.kubernetes.io/revision"  # counts the changes of a Deployment's pods
CERTIFICATE = "-----BEGIN CERTIFICATE-----\nMII=\n-----END CERTIFICATE-----\n"
Objects = Mapping[str, Any]


class Server:
    """The API server as its administrator sees it."""

    def __init__(self, process: ApiServerProcess, client: httpx.Client) -> None:
        self.process, self.client = process, client

    def make(self, path: str, body: Objects) -> None:
        answer = self.client.post(path, json=body)
        assert answer.is_success, answer.text

    def merge(self, path: str, body: Objects) -> None:
        answer = self.client.patch(path, content=json.dumps(body), headers=MERGE)
        assert answer.is_success, answer.text

    def get(self, path: str) -> Any:
        answer = self.client.get(path)
        assert answer.is_success, answer.text
        return answer.json()

    def everything(self) -> dict[str, Any]:
        """Every object by its path and name, without what counts its versions and what passes."""
        groups = [version["groupVersion"] for group in self.get("/apis")["groups"] for version in group["versions"]]
        objects = {}
        for path in ("/api/v1", *(f"/apis/{group}" for group in groups)):
            kinds = {one["name"] for one in self.get(path)["resources"] if "list" in one["verbs"]}
            for kind in kinds - PASSING:
                for item in self.get(f"{path}/{kind}").get("items", []):
                    metadata = item["metadata"]
                    for key in CHANGING:
                        metadata.pop(key, None)
                    metadata.get("annotations", {}).pop(REVISION, None)
                    item.pop("status", None)
                    item.get("spec", {}).pop("taints", None)  # nobody keeps these Nodes ready
                    objects[f"{path}/{kind}/{metadata.get('namespace', '')}/{metadata['name']}"] = item
        return objects


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Three Nodes, and a release of somebody else with a kept namespace."""
    folder = tmp_path_factory.mktemp("api")
    process = ApiServerProcess(folder)
    try:
        process.start()
        with controlling(folder, process.kubeconfig), process.client() as client:
            made = Server(process, client)
            for name in AGENTS:
                made.make("/api/v1/nodes", {"metadata": {"name": name}})
            labels = {"app.kubernetes.io/managed-by": "Helm"}
            theirs = {"meta.helm.sh/release-name": "theirs", "meta.helm.sh/release-namespace": "robotkube"}
            made.make("/api/v1/namespaces", {"metadata": {"name": "theirs", "labels": labels, "annotations": theirs}})
            until(lambda: "kube-root-ca.crt" in made.client.get("/api/v1/namespaces/theirs/configmaps").text, "settled")
            until(lambda: "finalizers" in made.client.get(SERVICE_ADDRESSES).text, "a controller keeps the addresses")
            yield made
    finally:
        process.stop()


@pytest.fixture
def given(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Existing]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(registry, "require", lambda *_: None)
    entries = [{"node": node, "role": role, "agent": agent} for node, (role, agent) in AGENTS.items()]
    (tmp_path / "agents.yaml").write_text(yaml.safe_dump({"agents": entries}))
    agents = tmp_path / "agents.yaml"
    kubeconfig = str(server.process.kubeconfig)
    reached = GivenCluster(kubeconfig, registry="registry.example/r", agents=agents, agreed=True)
    provider = Existing(reached, binaries=programs())
    yield provider
    provider._nodes._api.close()


def install(cluster: Existing, tmp_path: Path) -> str:
    """As the demo does it, without what needs Nodes that run pods; what is said of Argo CD."""
    cluster.up(TOPOLOGY, ())
    installer = Installer(programs(), cluster.kubeconfig(), tmp_path, cluster.chart_profile())
    said = installer.argocd(REFERENCES)
    installer.namespace("robotkube", {})
    key = installer.signing_key()
    values = installer.values(REFERENCES, TOPOLOGY) | {"evidence": key}
    (tmp_path / "values.yaml").write_text(yaml.safe_dump(values))
    installer.helm("-n", "robotkube", "install", "robotkube", CHART, "--no-hooks", "-f", str(tmp_path / "values.yaml"))
    return said


@contextmanager
def kubelets(server: Server) -> Iterator[None]:
    """Pods of Argo CD are ready, and that of the Job before the uninstallation ends well."""
    ended = threading.Event()

    def watch() -> None:
        with server.process.client() as client:
            while not ended.wait(0.2):
                for pod in client.get("/api/v1/pods").json().get("items", []):
                    namespace, name = pod["metadata"]["namespace"], pod["metadata"]["name"]
                    status = READY if namespace == "argocd" else ENDED if name.startswith("teardown-") else None
                    if status and pod["status"].get("phase") == "Pending":
                        place = f"/api/v1/namespaces/{namespace}/pods/{name}/status"
                        client.patch(place, content=json.dumps({"status": status}), headers=MERGE)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def test_an_installation_with_an_argo_cd_of_its_own_goes_whole(server: Server, given: Existing, tmp_path: Path) -> None:
    before = server.everything()
    assert install(given, tmp_path) == ""
    names = {one["metadata"]["name"] for one in server.get("/api/v1/namespaces")["items"]}
    assert {"robotkube", "robotkube-gate", "argocd", "cloud-0", "vehicle-00", "robotkube-suite-0"} <= names
    argocd = server.get("/apis/apps/v1/namespaces/argocd/deployments/argocd-server")
    [container] = argocd["spec"]["template"]["spec"]["containers"]
    assert container["image"] == f"registry.example/r/argocd@sha256:{'0' * 64}"
    asked = asked_before_down(given)
    [said] = [line.strip() for line in asked.splitlines() if "what was installed goes" in line]
    namespaces, _, claims = said.partition(", and what is in volume claims ")
    for name in ("robotkube", "robotkube-gate", "argocd", "cloud-0", "vehicle-00", "robotkube-suite-0"):
        assert name in namespaces.replace(",", "").split()
    assert {"robotkube/forge", "vehicle-00/bags"} <= set(claims.split(", "))
    with kubelets(server):
        removed = given.down()
    assert "Helm release robotkube/robotkube" in removed
    assert server.everything() == before
    assert given.down() == ()


def asked_before_down(cluster: Existing) -> str:
    """What a person is asked, who does not agree."""
    asked: list[str] = []

    def no(question: str) -> bool:
        asked.append(question)
        return False

    other = Existing(replace(cluster._given, agreed=False), no, programs())
    with pytest.raises(InputError, match="nothing was written, since nobody agreed"):
        other.down()
    other._nodes._api.close()
    [question] = asked
    return question


def test_an_argo_cd_of_others_is_used_and_gets_back_what_it_had(
    server: Server, given: Existing, tmp_path: Path
) -> None:
    argo_cd(server)
    with kubelets(server):
        until(lambda: all_ready(server), "Argo CD ready")
        before = server.everything()
        assert install(given, tmp_path) == "version 3.1 in namespace argocd, which was there"
        settings = server.get("/api/v1/namespaces/robotkube/configmaps/manager")["data"]
        asked = yaml.safe_load(settings["config.yaml"])["argocd"]
        assert asked["url"] == "https://argocd-server.argocd.svc.cluster.local"
        assert settings["argocd.crt"] == CERTIFICATE
        written_by_bootstrap(server)
        assert "project default is used by" in refusal_of_a_used_project(server, given, tmp_path)
        given.down()
    assert server.everything() == before


def test_a_platform_of_others_is_left_alone(server: Server, given: Existing, tmp_path: Path) -> None:
    server.make("/api/v1/namespaces", {"metadata": {"name": "robotkube"}})
    until(lambda: "kube-root-ca.crt" in server.client.get("/api/v1/namespaces/robotkube/configmaps").text, "settled")
    before = server.everything()
    with pytest.raises(InputError, match=r"namespace robotkube is there and was not made here"):
        install(given, tmp_path)
    assert given.down() == ()
    assert server.everything() == before


def refusal_of_a_used_project(server: Server, given: Existing, tmp_path: Path) -> str:
    """What is said while an Application uses the project that the platform closes."""
    path = "/apis/argoproj.io/v1alpha1/namespaces/argocd/applications"
    theirs = {"apiVersion": "argoproj.io/v1alpha1", "kind": "Application", "metadata": {"name": "theirs"}}
    server.make(path, {**theirs, "spec": {"project": "default"}})
    installer = Installer(programs(), given.kubeconfig(), tmp_path, given.chart_profile())
    with pytest.raises(SetUpError) as refused:
        installer.argocd(REFERENCES)
    server.client.delete(f"{path}/theirs")
    return str(refused.value)


def all_ready(server: Server) -> bool:
    items = server.get("/apis/apps/v1/namespaces/argocd/deployments")["items"]
    return all(one.get("status", {}).get("readyReplicas") for one in items)


def argo_cd(server: Server) -> None:
    """One that somebody else has installed, which runs."""
    server.make("/api/v1/namespaces", {"metadata": {"name": "argocd"}})
    argocd_definitions.define(server.client)
    for name, data in (("argocd-cm", {"url": "https://a"}), ("argocd-rbac-cm", {}), ("argocd-tls-certs-cm", {})):
        server.make("/api/v1/namespaces/argocd/configmaps", {"metadata": {"name": name}, "data": data})
    keys = {"server.secretkey": "k", "webhook.github.secret": "s", "tls.crt": CERTIFICATE, "tls.key": "k"}
    server.make("/api/v1/namespaces/argocd/secrets", {"metadata": {"name": "argocd-secret"}, "stringData": keys})
    project: dict[str, Any] = {
        "apiVersion": "argoproj.io/v1alpha1",
        "kind": "AppProject",
        "metadata": {"name": "default"},
    }
    project["spec"] = {"sourceRepos": ["*"], "destinations": [{"namespace": "*", "server": "*"}]}
    server.make("/apis/argoproj.io/v1alpha1/namespaces/argocd/appprojects", project)
    for part in PARTS:
        name = f"argocd-{part}"
        labels = {"app.kubernetes.io/part-of": "argocd", "app.kubernetes.io/component": part}
        container = {"name": part, "image": "quay.io/argoproj/argocd:v3.1.4"}
        template = {"metadata": {"labels": labels}, "spec": {"containers": [container]}}
        spec = {"replicas": 1, "selector": {"matchLabels": labels}, "template": template}
        deployment = {"metadata": {"name": name, "labels": labels}, "spec": spec}
        server.make("/apis/apps/v1/namespaces/argocd/deployments", deployment)
    until(lambda: "kube-root-ca.crt" in server.client.get("/api/v1/namespaces/argocd/configmaps").text, "settled")


def written_by_bootstrap(server: Server) -> None:
    """What the Job bootstrap writes into it."""
    core = "/api/v1/namespaces/argocd"
    server.merge(f"{core}/configmaps/argocd-cm", {"data": {"accounts.manager": "login"}})
    server.merge(f"{core}/configmaps/argocd-rbac-cm", {"data": {"policy.robotkube.csv": "p"}})
    server.merge(f"{core}/configmaps/argocd-tls-certs-cm", {"data": {"forge": "c"}})
    data = {"accounts.manager.password": "cA==", "webhook.github.secret": "bmV3", "webhook.gogs.secret": "bmV3"}
    server.merge(f"{core}/secrets/argocd-secret", {"data": data})
    closed = {"sourceRepos": [], "destinations": [], "namespaceResourceBlacklist": [{"group": "*", "kind": "*"}]}
    server.merge("/apis/argoproj.io/v1alpha1/namespaces/argocd/appprojects/default", {"spec": closed})
    for name, keys in (("server", ("hook-secret", "trusted-servers")), ("repo-server", ("trusted-servers",))):
        annotations = {f"robotkube.io/{key}": "f" for key in keys}
        annotated = {"spec": {"template": {"metadata": {"annotations": annotations}}}}
        server.merge(f"/apis/apps/v1/namespaces/argocd/deployments/argocd-{name}", annotated)
