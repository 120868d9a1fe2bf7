"""The bootstrap closes Argo CD's hooks of forges that nobody uses and names who signs the forge's certificate, by the
rights of its Job on a real API server."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import pytest
from kubernetes import client, config

from robotkube.errors import UnavailableError
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

pytestmark = pytest.mark.toolchain

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

    def set_up(self, setup: ArgoCDSetup = SETUP, sleep: Callable[[float], None] = time.sleep) -> list[str]:
        """What a run of the steps changed."""
        run = Bootstrap(30, time.monotonic, sleep)
        run.argocd(setup, self.job)
        return run.changed

    def restarted(self) -> set[str]:
        """Deployments whose pods are asked for anew since they were made."""
        return {deployment.metadata.name for deployment in self._deployments() if deployment.metadata.generation > 1}

    def pods(self, deployment: str, old: int = 0, new: int = 0) -> None:
        """What the controller of Deployments says of one: how many pods there are, all of them ready."""
        [match] = [one for one in self._deployments() if one.metadata.name == deployment]
        counts = {"replicas": old + new, "availableReplicas": old + new, "readyReplicas": old + new}
        status = {"observedGeneration": match.metadata.generation, "updatedReplicas": new, **counts}
        client.AppsV1Api(self.core.api_client).patch_namespaced_deployment_status(
            deployment, NAMESPACE, {"status": status}
        )

    def _deployments(self) -> list[Any]:
        items: list[Any] = client.AppsV1Api(self.core.api_client).list_namespaced_deployment(NAMESPACE).items
        return items

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


TRUST_READER = "argocd-repo-server"


def test_who_asks_the_repo_server_starts_again_when_it_believes_the_authority(argocd: ArgoCD) -> None:
    """Before that the ApplicationSet controller could not generate anything, and would try again in three minutes."""
    seen: list[set[str]] = []
    rollout = iter([{"old": 1}, {"old": 1, "new": 1}, {"new": 1}])

    def sleep(seconds: float) -> None:
        seen.append(argocd.restarted())
        argocd.pods(TRUST_READER, **next(rollout))

    first = replace(SETUP, trusted={"forge.example": "one"}, trust_readers=(TRUST_READER,))
    changed = argocd.set_up(first, sleep)
    assert seen == [{TRUST_READER}] * 3
    assert [one for one in changed if "deployment" in one] == [f"deployment {TRUST_READER}", *RESTARTS]
    assert argocd.restarted() == {TRUST_READER, *READERS}
    assert argocd.set_up(first) == []


def test_another_authority_restarts_who_verifies_by_it(argocd: ArgoCD) -> None:
    def sleep(seconds: float) -> None:
        argocd.pods(TRUST_READER, new=1)

    first = replace(SETUP, trusted={"forge.example": "one"}, trust_readers=(TRUST_READER,))
    argocd.set_up(first, sleep)
    changes = ["argocd-tls-certs-cm", f"deployment {TRUST_READER}", *RESTARTS]
    assert argocd.set_up(replace(first, trusted={"forge.example": "another"}), sleep) == changes
    assert argocd.set_up(SETUP) == []
    kept = argocd.core.read_namespaced_config_map("argocd-tls-certs-cm", NAMESPACE).data
    assert kept == {"forge.example": "another"}


def test_a_restart_that_does_not_end_is_told(argocd: ArgoCD) -> None:
    run = Bootstrap(0, time.monotonic, time.sleep)
    first = replace(SETUP, trusted={"forge.example": "one"}, trust_readers=(TRUST_READER,))
    with pytest.raises(UnavailableError, match="argocd/argocd-repo-server: 0 of 1 new pods are ready"):
        run.argocd(first, argocd.job)


def test_an_upgrade_closes_what_the_version_before_left_open(argocd: ArgoCD) -> None:
    """That version set the gate's secret alone."""
    argocd.write("webhook.github.secret", SETUP.hook_secret)
    argocd.write("webhook.gogs.secret", "")
    assert {"hook secrets", *RESTARTS} <= set(argocd.set_up())
    assert all(argocd.hooks[key] for key in UNUSED)
