"""The bootstrap closes Argo CD's hooks of forges that nobody uses and names who signs the forge's certificate, by the
rights of its Job on a real API server."""

from __future__ import annotations

import base64
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import pytest
from kubernetes import client, config

from robotkube.setup.adapters.argocd_configuration import KubernetesArgoCDConfiguration
from robotkube.setup.loops.bootstrap import ArgoCDSetup, Bootstrap
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.kubernetes.argocd_objects import (
    NAMESPACE,
    bootstrap_kubeconfig,
    connect,
    define_argocd,
    make_argocd,
    remove_argocd,
)

pytestmark = [pytest.mark.toolchain, pytest.mark.filterwarnings("ignore::urllib3.exceptions.InsecureRequestWarning")]

READERS = ("argocd-server", "argocd-applicationset-controller")
SETUP = ArgoCDSetup("manager", "password", "p, role:x\n", "secret of the gate", "default", READERS)
RESTARTS = [f"deployment {reader}" for reader in READERS]
UNUSED = {
    "webhook.gitlab.secret",
    "webhook.gogs.secret",
    "webhook.bitbucket.uuid",
    "webhook.bitbucketserver.secret",
    "webhook.azuredevops.username",
    "webhook.azuredevops.password",
}


@dataclass
class ArgoCD:
    """Argo CD's objects; `job` has the rights of the bootstrap Job, `core` all."""

    core: client.CoreV1Api
    job: KubernetesArgoCDConfiguration

    def set_up(self, setup: ArgoCDSetup = SETUP) -> list[str]:
        """What a run of the steps changed."""
        run = Bootstrap(30, time.monotonic, time.sleep)
        run.argocd(setup, self.job)
        return run.changed

    def write(self, key: str, value: str) -> None:
        """A value that a person enters."""
        self.core.patch_namespaced_secret("argocd-secret", NAMESPACE, {"stringData": {key: value}})

    @property
    def hooks(self) -> dict[str, str]:
        """What Argo CD checks hooks with."""
        data = self.core.read_namespaced_secret("argocd-secret", NAMESPACE).data
        return {key: base64.b64decode(value).decode() for key, value in data.items() if key.startswith("webhook.")}


@pytest.fixture(scope="module")
def connections(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[client.ApiClient, client.ApiClient]]:
    """To an API server with Argo CD's namespace: the administrator's, and the Job's."""
    folder = tmp_path_factory.mktemp("api")
    server = ApiServerProcess(folder)
    try:
        server.start()
        everything = connect(server)
        define_argocd(everything)
        job = config.new_client_from_config(str(bootstrap_kubeconfig(server, folder)))
        yield everything, job
        job.close()
        everything.close()
    finally:
        server.stop()


@pytest.fixture
def argocd(connections: tuple[client.ApiClient, client.ApiClient]) -> Iterator[ArgoCD]:
    """As it comes, for each test."""
    everything, job = connections
    make_argocd(everything)
    yield ArgoCD(client.CoreV1Api(everything), KubernetesArgoCDConfiguration(job, NAMESPACE))
    remove_argocd(everything)


def test_each_hook_has_a_secret_of_its_own_that_stays(argocd: ArgoCD) -> None:
    assert {"hook secrets", *RESTARTS} <= set(argocd.set_up())
    made = argocd.hooks
    assert set(made) == UNUSED | {"webhook.github.secret"}
    assert made["webhook.github.secret"] == SETUP.hook_secret
    assert len(set(made.values())) == len(made)
    assert {len(made[key]) for key in UNUSED} == {64}
    assert argocd.set_up() == []
    assert argocd.set_up(replace(SETUP, hook_secret="another")) == ["hook secrets", *RESTARTS]  # noqa: S106
    assert argocd.hooks == made | {"webhook.github.secret": "another"}


def test_a_hook_that_people_use_goes_on(argocd: ArgoCD) -> None:
    argocd.write("webhook.gitlab.secret", "of a person")
    argocd.set_up()
    assert argocd.hooks["webhook.gitlab.secret"] == "of a person"
    argocd.write("webhook.gitlab.secret", "another of a person")
    assert argocd.set_up() == RESTARTS
    assert argocd.hooks["webhook.gitlab.secret"] == "another of a person"


def test_who_reads_certificates_starts_again_when_another_authority_signs_them(argocd: ArgoCD) -> None:
    argocd.set_up()
    first = replace(SETUP, trusted={"forge.example": "one"}, trust_readers=("argocd-repo-server",))
    changes = ["argocd-tls-certs-cm", "deployment argocd-repo-server"]
    assert argocd.set_up(first) == changes
    assert argocd.set_up(first) == []
    assert argocd.set_up(replace(first, trusted={"forge.example": "another"})) == changes
    assert argocd.set_up(SETUP) == []
    kept = argocd.core.read_namespaced_config_map("argocd-tls-certs-cm", NAMESPACE).data
    assert kept == {"forge.example": "another"}


def test_an_upgrade_closes_what_the_version_before_left_open(argocd: ArgoCD) -> None:
    """That version set the gate's secret alone."""
    argocd.write("webhook.github.secret", SETUP.hook_secret)
    argocd.write("webhook.gogs.secret", "")
    assert {"hook secrets", *RESTARTS} <= set(argocd.set_up())
    assert all(argocd.hooks[key] for key in UNUSED)
