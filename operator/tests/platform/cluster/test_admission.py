"""Attacks on the running platform that the API server refuses, in the words of the table in docs/explanation/trust.md.
Nothing would stay of one that is taken: all of them are dry runs. Each rule by itself:
registry/admission/test_policies_api_server.py."""

from __future__ import annotations

import copy
import ssl
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import pytest

from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.admission.stranded import stranded_now
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import plan_of
from ci.cluster_contract import topology
from ci.images import image_lock
from robotkube.registry.admission.core.domain import account
from tests.stages.attacks import words_of
from tests.stages.kubernetes.judged_api_server import ADMINISTRATOR, MERGE, Requests
from tests.stages.paths import WIDEST
from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.registry.admission_examples import APPLICATIONS as PLACE
from tests.stages.registry.admission_examples import PROJECTS, STRANGE

AGENT, RELEASE, TESTS = "vehicle-02", "mqtt-bridge", "robotkube-suite-0"
PODS = f"/api/v1/namespaces/{AGENT}/pods"
DEPLOYMENT = f"/apis/apps/v1/namespaces/{AGENT}/deployments/{RELEASE}"
POLICIES = "/apis/admissionregistration.k8s.io/v1/validatingadmissionpolicies"
DRY = "?dryRun=All"
CONTROLLER = account("kube-system", "replicaset-controller")
GENERATOR, SERVER = account("argocd", "argocd-applicationset-controller"), account("argocd", "argocd-server")
SUITE_RUNNER = account("robotkube", "suite-runner")
RESTRICTED = {
    "allowPrivilegeEscalation": False,
    "capabilities": {"drop": ["ALL"]},
    "runAsNonRoot": True,
    "seccompProfile": {"type": "RuntimeDefault"},
}
Object = dict[str, Any]


@dataclass(frozen=True)
class Running:
    """The API server of the platform, and the release that is attacked: its image by digest, and its pod."""

    api: Requests
    image: str
    pod: str

    def pod_with(self, **spec: Any) -> Object:
        """A pod as restricted as all others, of the release's image."""
        return {"metadata": {"name": "attacker"}, "spec": {"containers": [container(self.image)], **spec}}

    def containers(self) -> list[Object]:
        """The release's containers as they are."""
        containers: list[Object] = self.api.done("GET", DEPLOYMENT)["spec"]["template"]["spec"]["containers"]
        return containers

    def application(self, **source: Any) -> Object:
        """An Application like that of the release, with another source."""
        application = copy.deepcopy(self.api.done("GET", f"{PLACE}/{AGENT}-{RELEASE}"))
        application["spec"]["source"].update(source)
        return {**application, "metadata": {"name": "attacker", "namespace": "argocd"}, "status": {}}


def container(reference: str, name: str = "main") -> Object:
    return {"name": name, "image": reference, "securityContext": RESTRICTED}


@pytest.fixture(scope="module")
def running(platform: Platform) -> Iterator[Running]:
    eventually("all Applications synced and healthy", platform.settled)
    folders = ClusterFolders(platform.name)
    context = ssl.create_default_context(cafile=str(folders.pki / "ca.crt"))
    context.load_cert_chain(folders.pki / "admin.crt", folders.pki / "admin.key")
    address = f"https://{plan_of(platform.name).gateway}:6443"
    with httpx.Client(base_url=address, verify=context, timeout=30) as client:
        api = Requests(client)
        [pod] = platform.get("-n", AGENT, "pods", "-l", f"app.kubernetes.io/instance={RELEASE}")["items"]
        yield Running(api, pod["spec"]["containers"][0]["image"], pod["metadata"]["name"])


Attack = Callable[[Running], str]


def patched(place: str, change: Object, user: str = ADMINISTRATOR) -> Attack:
    return lambda running: running.api.refusal("PATCH", f"{place}{DRY}", change, user, MERGE)


def with_sidecar(running: Running) -> str:
    change = {"spec": {"template": {"spec": {"containers": [*running.containers(), container(running.image, "side")]}}}}
    return running.api.refusal("PATCH", f"{DEPLOYMENT}{DRY}", change, kind=MERGE)


def debugging(running: Running) -> str:
    change = {"spec": {"ephemeralContainers": [container(running.image, "debug")]}}
    return running.api.refusal("PATCH", f"{PODS}/{running.pod}/ephemeralcontainers{DRY}", change, kind=MERGE)


def other_source(running: Running) -> str:
    change = {"operation": {"sync": {"revision": "sha256:" + "d" * 64}}}
    return running.api.refusal("PATCH", f"{PLACE}/{AGENT}-{RELEASE}{DRY}", change, SERVER, MERGE)


ATTACKS: dict[str, Attack] = {
    "image-by-manager": lambda running: running.api.refusal(
        "POST", f"{PODS}{DRY}", running.pod_with(containers=[container(STRANGE)]), CONTROLLER
    ),
    "pod-by-administrator": lambda running: running.api.refusal("POST", f"{PODS}{DRY}", running.pod_with()),
    "image-volume": lambda running: running.api.refusal(
        "POST",
        f"{PODS}{DRY}",
        running.pod_with(volumes=[{"name": "model", "image": {"reference": STRANGE}}]),
        CONTROLLER,
    ),
    "sidecar": with_sidecar,
    "annotation": patched(DEPLOYMENT, {"metadata": {"annotations": {"note": "mine"}}}),
    "ephemeral-container": debugging,
    "application-by-argocd": lambda running: running.api.refusal(
        "POST", f"{PLACE}{DRY}", running.application(targetRevision="sha256:" + "d" * 64), GENERATOR
    ),
    "operation-with-source": other_source,
    "project-widened": patched(
        f"{PROJECTS}/robotkube-apps",
        {"spec": {"clusterResourceWhitelist": [{"group": "*", "kind": "*"}]}},
        SERVER,
    ),
    "tag-moves": lambda running: running.api.refusal(
        "POST",
        f"/api/v1/namespaces/{TESTS}/pods{DRY}",
        running.pod_with(containers=[container(running.image.partition("@")[0] + ":1.0")]),
        SUITE_RUNNER,
    ),
    "platform-image-pushed": lambda running: running.api.refusal(
        "POST",
        f"/api/v1/namespaces/robotkube/pods{DRY}",
        running.pod_with(containers=[container(STRANGE)]),
        CONTROLLER,
    ),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_an_attack_is_refused_in_the_words_of_the_table(running: Running, attack: str) -> None:
    expected = words_of(attack, "admission")
    said = ATTACKS[attack](running)
    assert expected.pattern.search(said), said


def test_the_policies_are_neither_seen_nor_deleted(running: Running) -> None:
    assert running.api.done("GET", POLICIES)["items"] == []
    gone = running.api.request("DELETE", f"{POLICIES}/robotkube-agents.static.k8s.io")
    assert words_of("policy-deleted", "admission").pattern.search(gone["message"])


def test_nothing_that_runs_would_be_stranded(platform: Platform, running: Running) -> None:
    """The list has all that was published, and what the platform was installed with."""
    stranded = stranded_now(ClusterFolders(platform.name), topology.read(WIDEST / "scenario.yaml"), _lock())
    assert stranded.stranded == (), stranded.lines


def _lock() -> tuple[image_lock.Image, ...]:
    return image_lock.read_lock(image_lock.lock_file())


def test_the_host_follows_the_catalogue_and_has_nothing_to_complain(platform: Platform, running: Running) -> None:
    """Its log says once that the forge was not installed yet, and then what it has written."""
    log = (ClusterFolders(platform.name).log / f"{admission_files.PROCESS}.log").read_text()
    lines = [line for line in log.splitlines() if "WARNING" in line]
    assert [line for line in lines if "not installed yet" not in line and "no catalogue yet" not in line] == [], log
    assert len([line for line in lines if "not installed yet" in line]) <= 2, log  # no claim yet, then no volume
    assert "admission policies written charts=" in log
