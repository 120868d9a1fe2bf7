"""The remover as the chart installs it, on a real API server under the chart's admission: what it takes away by its own
account, what it is refused, and that nothing else is touched."""

from __future__ import annotations

import copy
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from robotkube.delivery.inspection.adapters.kubernetes_inspections import KubernetesInspections
from robotkube.delivery.inspection.core.statuses import status_of
from robotkube.delivery.inspection.core.strangers import (
    CONTAINER,
    FOREIGN_CONTAINER,
    KUBELET,
    NO_RELEASE,
    POD,
    RELEASES,
    Look,
    Stranger,
)
from robotkube.delivery.inspection.core.workload_checks import strangers_among
from robotkube.delivery.removal.adapters.removal_cluster import KubernetesRemoval
from robotkube.delivery.removal.core.targets import RemovalPolicy
from robotkube.delivery.removal.loops.remover import Remover
from robotkube.delivery.removal.settings import read_configuration
from robotkube.errors import InputError
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.registry.admission import __main__ as admission
from robotkube.registry.admission.core.domain import APPLICATION_CONTROLLER, account
from robotkube.registry.admission.core.list_objects import documents_for_api
from robotkube.registry.admission.core.listing import AllowedVersions
from tests.charts.conftest import PLATFORM, Helm
from tests.charts.test_admission import FILES
from tests.stages import http_calls
from tests.stages.delivery.inspection.inspected_node import CHART, IMAGE, RENDERED, VERIFIED, permitted
from tests.stages.kubernetes.installed_chart import Cluster, prepared_cluster
from tests.stages.programs import free_port, program
from tests.stages.settings_mounted import mounted
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain
REMOVER = account("robotkube", "remover")
ARGOCD = account("argocd", APPLICATION_CONTROLLER)
REPLICA_SETS = account("kube-system", "replicaset-controller")
PODS, DEPLOYMENTS = "/api/v1/namespaces/{}/pods", "/apis/apps/v1/namespaces/{}/deployments"
JSON_PATCH = "application/json-patch+json"
AGENT = "vehicle-00"
STAMP = time.time_ns

Object = dict[str, Any]


@dataclass
class Stage:
    """The installed platform, and calls by the administrator, by the remover, and by accounts that are impersonated."""

    cluster: Cluster
    calls: httpx.Client
    administrator: ApiServer
    remover: ApiServer
    policy: RemovalPolicy
    numbers: Iterator[int] = field(default_factory=lambda: iter(range(10_000)))

    def made(self, path: str, body: Object, user: str = "") -> Object:
        """An object that is made, as `user`."""
        done = self.calls.post(path, json=body, headers={"Impersonate-User": user} if user else {})
        assert done.is_success, done.text
        return dict(done.json())

    def pod(self, namespace: str = AGENT, owner: str = "") -> Object:
        """A pod that runs there, as its controller makes it."""
        name = f"{owner or 'foreign'}-{next(self.numbers)}"
        limits = {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}, "runAsNonRoot": True}
        container = {"name": "main", "image": IMAGE, "securityContext": limits}
        spec = {"containers": [container], "securityContext": {"seccompProfile": {"type": "RuntimeDefault"}}}
        body = {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": name, "namespace": namespace}, "spec": spec}
        return self.made(PODS.format(namespace), body, REPLICA_SETS if namespace == AGENT else "")

    def deployment(self, name: str) -> Object:
        """A release's Deployment as Argo CD makes it."""
        body = copy.deepcopy({**RENDERED})
        body["metadata"] |= {"name": name, "namespace": AGENT}
        return self.made(DEPLOYMENTS.format(AGENT), body, ARGOCD)

    def patched(self, path: str, *steps: Object) -> Object:
        """A Deployment after a change by who may make it."""
        headers = {"Content-Type": JSON_PATCH, "Impersonate-User": ARGOCD}
        done = self.calls.patch(path, content=json.dumps(steps), headers=headers)
        assert done.is_success, done.text
        return dict(done.json())

    def named(self, look: Look) -> None:
        """An inspector reports these."""
        inspections = KubernetesInspections(self.administrator, "robotkube", "inspector", time.time)
        inspections.write(look, status_of(look, inspections.status(look.name) or {}, time_text(STAMP())))

    def status(self, name: str) -> Object:
        inspection = self.administrator.get(f"/apis/robotkube.io/v1alpha1/namespaces/robotkube/inspections/{name}")
        assert inspection is not None
        return dict(inspection["status"])

    def condition(self, name: str, kind: str = "Removed") -> tuple[str, str]:
        [one] = [c for c in self.status(name)["conditions"] if c["type"] == kind]
        return one["status"], one["reason"]

    def events(self, name: str) -> list[str]:
        listed = self.administrator.get("/apis/events.k8s.io/v1/namespaces/robotkube/events") or {}
        return [one["reason"] for one in listed["items"] if one["regarding"]["name"] == name]

    def new_remover(self, policy: RemovalPolicy | None = None) -> Remover:
        """A remover that knows nothing of earlier removals."""
        cluster = KubernetesRemoval(self.remover, "robotkube", STAMP)
        return Remover(cluster, policy or self.policy, time.monotonic, STAMP, lambda: 0.5)


@pytest.fixture(scope="module")
def stage(helm: Helm, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    folder = tmp_path_factory.mktemp("api")
    files = [option for path in FILES for option in ("-f", str(path))]
    switches = ("--set", "remover.enabled=true", "--set", "admission.enabled=true")
    with prepared_cluster(folder) as cluster:
        cluster.helm("install", "robotkube", str(PLATFORM), *files, *switches, "--no-hooks")
        rendered = helm.template(PLATFORM, *FILES, admission={"enabled": True}, remover={"enabled": True})
        judged = read_settings(mounted(rendered, "admission", folder), admission.read_configuration).domain
        written = documents_for_api(judged, AllowedVersions((CHART,), (VERIFIED,)))  # as the chart's process does
        cluster.kubectl("apply", "-f", "-", text=json.dumps({"apiVersion": "v1", "kind": "List", "items": written}))
        server = yaml.safe_load(cluster.kubeconfig.read_text())["clusters"][0]["cluster"]["server"]
        for name, user in (("argocd", ARGOCD), ("controller", REPLICA_SETS)):  # as their rights in a cluster
            cluster.kubectl("create", "clusterrolebinding", name, "--clusterrole=cluster-admin", f"--user={user}")
        whole = _stage(cluster, server, folder)
        yield whole
        whole.calls.close()
        whole.administrator.close()
        whole.remover.close()


def _stage(cluster: Cluster, server: str, folder: Path) -> Stage:
    tokens = {"administrator": (folder / "tokens.csv").read_text().partition(",")[0]}
    tokens["remover"] = cluster.kubectl("create", "token", "remover")
    accounts = {}
    for name, token in tokens.items():
        (folder / name).write_text(token)
        accounts[name] = ApiServer(server, folder / name, folder / "certificates" / "apiserver.crt")
    config = json.loads(cluster.kubectl("get", "configmap", "remover", "-o", "json"))["data"]["config.yaml"]
    (folder / "config.yaml").write_text(config)
    settings = read_settings(folder / "config.yaml", read_configuration)
    whole = Stage(cluster, cluster.client(), accounts["administrator"], accounts["remover"], settings.policy)
    sidecar = [{"op": "add", "path": "/metadata/annotations", "value": {"mine": "1"}}]
    probe = whole.deployment("probe")
    until(lambda: _refused(whole, f"{DEPLOYMENTS.format(AGENT)}/{probe['metadata']['name']}", sidecar), "admission")
    return whole


def _refused(stage: Stage, path: str, patch: list[Object]) -> str:
    """The words with which the remover's own account is refused a change; empty when it is not."""
    try:
        stage.remover.request("PATCH", f"{path}?dryRun=All", patch, JSON_PATCH)
    except InputError as error:
        return str(error)
    return ""


def foreign(pod: Object, kind: str = POD, reason: str = NO_RELEASE, **changes: Any) -> Stranger:
    metadata = pod["metadata"]
    words = {"uid": metadata["uid"], "container": "side" if kind == CONTAINER else "", **changes}
    return Stranger(kind, metadata["namespace"], metadata["name"], reason, "it is a stranger. Look at it", **words)


def test_the_chart_says_for_whom_and_how_much(stage: Stage) -> None:
    assert stage.policy == RemovalPolicy(frozenset({"vehicle-00", "cloud-0"}), True, True, 20)


def test_a_foreign_pod_goes_and_no_other_one(stage: Stage) -> None:
    stranger, own, elsewhere = stage.pod(), stage.pod(owner="detector"), stage.pod("default")
    stage.named(Look(KUBELET, (foreign(stranger), foreign(elsewhere)), node="one"))
    remover = stage.new_remover()
    remover.turn()
    assert stage.administrator.get(f"{PODS.format(AGENT)}/{stranger['metadata']['name']}") is None
    for kept in (own, elsewhere):
        path = f"{PODS.format(kept['metadata']['namespace'])}/{kept['metadata']['name']}"
        now = stage.administrator.get(path)
        assert now is not None
        assert now["metadata"]["uid"] == kept["metadata"]["uid"]
        assert "deletionTimestamp" not in now["metadata"]
    assert stage.condition("kubelet.one") == ("False", "NotAnAgents")
    assert "Removed" in stage.events("kubelet.one")


def test_each_process_has_conditions_of_its_own(stage: Stage) -> None:
    """What looks writes its status as a whole, and what was said of removals stays."""
    stranger = stage.pod()
    remover = stage.new_remover()
    stage.named(Look(KUBELET, (foreign(stranger),), node="two"))
    remover.turn()
    assert stage.condition("kubelet.two") == ("False", "Removing")
    assert stage.condition("kubelet.two", "Clean") == ("False", "Strangers")
    stage.named(Look(KUBELET, (), node="two"))
    assert stage.condition("kubelet.two") == ("False", "Removing")
    assert stage.condition("kubelet.two", "Clean") == ("True", "AllKnown")
    assert stage.status("kubelet.two")["strangers"] == []
    remover.turn()
    assert stage.condition("kubelet.two") == ("True", "NothingNamed")
    assert stage.condition("kubelet.two", "Seen") == ("True", "Looked")


def test_another_pod_under_the_same_name_stays(stage: Stage) -> None:
    gone = stage.pod()
    path = f"{PODS.format(AGENT)}/{gone['metadata']['name']}"
    stage.named(Look(KUBELET, (foreign(gone),), node="one"))
    stage.administrator.delete(path)
    again = {key: gone[key] for key in ("apiVersion", "kind", "spec")}
    names = {"name": gone["metadata"]["name"], "namespace": AGENT}
    stage.made(PODS.format(AGENT), {**again, "metadata": names}, REPLICA_SETS)
    stage.new_remover().turn()
    assert stage.administrator.get(path) is not None
    cluster = KubernetesRemoval(stage.remover, "robotkube", STAMP)
    assert cluster.delete_pod(gone, 0) is False
    assert stage.administrator.get(path) is not None


def test_a_pod_that_was_changed_meanwhile_stays_until_it_is_read_again(stage: Stage) -> None:
    before = stage.pod()
    name = before["metadata"]["name"]
    stage.cluster.kubectl("label", "pod", name, "-n", AGENT, "mine=1", "--as", REPLICA_SETS)
    cluster = KubernetesRemoval(stage.remover, "robotkube", STAMP)
    assert cluster.delete_pod(before, 0) is False
    now = cluster.pod(AGENT, name)
    assert now is not None
    assert cluster.delete_pod(now, 0) is True
    assert cluster.delete_pod(now, 0) is False
    assert cluster.pod(AGENT, name) is None


def test_a_changed_deployment_is_what_its_chart_renders_again(stage: Stage) -> None:
    stage.deployment("detector")
    path = f"{DEPLOYMENTS.format(AGENT)}/detector"
    spec = "/spec/template/spec"
    live = stage.patched(
        path,
        {"op": "add", "path": f"{spec}/containers/0", "value": {"name": "side", "image": IMAGE}},
        {"op": "add", "path": f"{spec}/containers/1/env/0", "value": {"name": "LD_PRELOAD", "value": "x"}},
        {"op": "add", "path": f"{spec}/volumes/-", "value": {"name": "more", "emptyDir": {}}},
        {"op": "add", "path": "/spec/template/metadata/annotations", "value": {"example.com/a": "1"}},
        {"op": "add", "path": "/metadata/annotations", "value": {"example.com/a": "1"}},
    )
    [stranger] = strangers_among(live, "Deployment", permitted())
    assert len(stranger.excess) == 5
    stage.named(Look(RELEASES, (stranger,)))
    stage.new_remover().turn()
    restored = stage.administrator.get(path)
    assert restored is not None
    assert list(strangers_among(restored, "Deployment", permitted())) == [], stage.status("releases")["conditions"]
    assert [one["name"] for one in restored["spec"]["template"]["spec"]["containers"]] == ["detector"]
    assert stage.condition("releases") == ("False", "Restoring")
    assert "Restored" in stage.events("releases")


def test_a_deployment_that_changes_meanwhile_is_not_patched(stage: Stage) -> None:
    live = stage.deployment("changing")
    path = f"{DEPLOYMENTS.format(AGENT)}/changing"
    stage.patched(path, {"op": "add", "path": "/spec/template/spec/volumes/-", "value": {"name": "x", "emptyDir": {}}})
    version = {"op": "replace", "path": "/metadata/resourceVersion", "value": live["metadata"]["resourceVersion"]}
    patch = [version, {"op": "remove", "path": "/spec/template/spec/volumes/0"}]
    cluster = KubernetesRemoval(stage.remover, "robotkube", STAMP)
    assert cluster.patch_deployment(live, patch) is False
    now = stage.administrator.get(path)
    assert now is not None
    assert [one["name"] for one in now["spec"]["template"]["spec"]["volumes"]] == ["settings", "x"]


def test_what_admission_refuses_is_said(stage: Stage) -> None:
    """Whoever writes Inspections cannot make the remover weaken a pod."""
    stage.deployment("limited")
    path = f"{DEPLOYMENTS.format(AGENT)}/limited"
    limits = {"op": "add", "path": "/spec/template/spec/securityContext", "value": {"runAsNonRoot": True}}
    live = stage.patched(path, limits)["metadata"]
    words = {"uid": live["uid"], "generation": live["generation"], "excess": ("/spec/template/spec/securityContext",)}
    stranger = Stranger("Deployment", AGENT, "limited", "NotOfTheChart", "it was changed. Look at it", **words)
    stage.named(Look(RELEASES, (stranger,)))
    stage.new_remover().turn()
    assert stage.condition("releases") == ("False", "Refused")
    [said] = [c["message"] for c in stage.status("releases")["conditions"] if c["type"] == "Removed"]
    assert f"limited changed by {REMOVER}: in an agent's namespace nothing runs but what main says" in said
    assert "Refused" in stage.events("releases")


def test_a_container_beside_the_own_ones_takes_its_pod_along(stage: Stage) -> None:
    pod = stage.pod(owner="detector")
    stage.named(Look(KUBELET, (foreign(pod, CONTAINER, FOREIGN_CONTAINER),), node="one"))
    stage.new_remover(RemovalPolicy(stage.policy.agents, pods=False)).turn()
    path = f"{PODS.format(AGENT)}/{pod['metadata']['name']}"
    assert stage.administrator.get(path) is not None
    assert stage.condition("kubelet.one") == ("False", "NotByPolicy")
    stage.new_remover().turn()
    assert stage.administrator.get(path) is None


@pytest.fixture
def as_remover(stage: Stage) -> Iterator[str]:
    """The way to the API server on which calls are the remover's account's."""
    kubeconfig = stage.cluster.kubeconfig
    environment = {**os.environ, "KUBECONFIG": str(kubeconfig), "HOME": str(kubeconfig.parent)}
    words = [program("kubectl"), "proxy", "--port=0", f"--as={REMOVER}"]
    proxy = subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True)
    assert proxy.stdout is not None
    yield "http://" + proxy.stdout.readline().split()[-1]
    proxy.kill()
    proxy.communicate(timeout=10)


def test_the_process_removes_until_it_is_stopped(stage: Stage, as_remover: str, tmp_path: Path) -> None:
    """As the chart configures it, but at a port that is free here; within 128 MiB, as its limit says."""
    port = free_port()
    config = (stage.cluster.kubeconfig.parent / "config.yaml").read_text().replace("8081", str(port))
    (tmp_path / "config.yaml").write_text(config.replace("address: 0.0.0.0", "address: 127.0.0.1"))
    variables = {"ROBOTKUBE_API_SERVER": as_remover, "ROBOTKUBE_CONFIG": str(tmp_path / "config.yaml")}
    stranger = stage.pod()
    stage.named(Look(KUBELET, (foreign(stranger),), node="one"))
    command = [sys.executable, "-m", "robotkube.delivery.removal"]
    process = subprocess.Popen(command, env={**os.environ, **variables}, stderr=subprocess.PIPE, text=True)
    try:
        path = f"{PODS.format(AGENT)}/{stranger['metadata']['name']}"
        until(lambda: stage.administrator.get(path) is None, "the pod is gone")
        until(lambda: http_calls.get(f"http://127.0.0.1:{port}/readyz").is_success, "it is ready")
        page = http_calls.get(f"http://127.0.0.1:{port}/metrics").text
        assert 'robotkube_removals_total{act="delete",result="done"} 1.0' in page
        [resident] = [line.split()[1] for line in page.splitlines() if line.startswith("process_resident_memory")]
        assert float(resident) < 64 * 1024 * 1024
    finally:
        process.terminate()
        _, written = process.communicate(timeout=20)
    assert process.returncode == 0, written
    assert "stranger removed" in written


NAMES = {"metadata": {"name": "x"}}
FORBIDDEN: dict[str, tuple[str, str, Any]] = {
    "make a pod": ("POST", PODS.format(AGENT), NAMES),
    "change a pod": ("PATCH", f"{PODS.format(AGENT)}/x", []),
    "list pods": ("GET", PODS.format(AGENT), None),
    "delete all pods": ("DELETE", PODS.format(AGENT), None),
    "run a command": ("POST", f"{PODS.format(AGENT)}/x/exec?command=sh", None),
    "delete a pod of the platform": ("DELETE", f"{PODS.format('robotkube')}/x", None),
    "delete a pod of Argo CD": ("DELETE", f"{PODS.format('argocd')}/x", None),
    "delete a pod under test": ("DELETE", f"{PODS.format('robotkube-suite-0')}/x", None),
    "make a Deployment": ("POST", DEPLOYMENTS.format(AGENT), NAMES),
    "delete a Deployment": ("DELETE", f"{DEPLOYMENTS.format(AGENT)}/detector", None),
    "scale a Deployment": ("PATCH", f"{DEPLOYMENTS.format(AGENT)}/detector/scale", []),
    "patch a Deployment of the platform": ("PATCH", f"{DEPLOYMENTS.format('robotkube')}/gate", []),
    "read a Secret": ("GET", f"/api/v1/namespaces/{AGENT}/secrets/x", None),
    "change settings": ("PATCH", f"/api/v1/namespaces/{AGENT}/configmaps/x", []),
    "change an Inspection": ("PATCH", "/apis/robotkube.io/v1alpha1/namespaces/robotkube/inspections/releases", []),
    "make an Inspection": ("POST", "/apis/robotkube.io/v1alpha1/namespaces/robotkube/inspections", NAMES),
    "write an Application": ("POST", "/apis/argoproj.io/v1alpha1/namespaces/argocd/applications", NAMES),
}


@pytest.mark.parametrize("what", FORBIDDEN)
def test_its_account_may_do_nothing_else(stage: Stage, what: str) -> None:
    method, path, body = FORBIDDEN[what]
    kind = JSON_PATCH if method == "PATCH" else "application/json"
    with pytest.raises(InputError, match=r"403.*forbidden"):
        stage.remover.request(method, path, body, kind)
