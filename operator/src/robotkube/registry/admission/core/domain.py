"""The domain of admission: whose namespaces are whose, and which accounts write there."""

from __future__ import annotations

from dataclasses import dataclass

from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import CHARTS_URL, FOLDER, NAME

CONTROLLERS = "kube-system"
APPLICATION_CONTROLLER, GENERATOR = "argocd-application-controller", "argocd-applicationset-controller"
SUITE_RUNNER, REMOVER = "suite-runner", "remover"
PROJECT = "robotkube-apps"
# Who of the controller manager makes pods: the controller of what stands above them.
POD_MAKERS = (
    "daemon-set-controller",
    "job-controller",
    "replicaset-controller",
    "replication-controller",
    "statefulset-controller",
)
# Who of it changes what others made: owners, finalizers, annotations of their own.
KEEPERS = (
    *POD_MAKERS,
    "cronjob-controller",
    "deployment-controller",
    "generic-garbage-collector",
    "ttl-after-finished-controller",
)


@dataclass(frozen=True)
class Domain:
    """Namespaces of `agents` (releases run there), of `tests` (suites try charts there), of the platform, of its gate
    and of Argo CD; `charts` is the one place of charts that may run, as `oci://<host>/<organisation>`. `elsewhere`: all
    other namespaces of the cluster are judged too, which is right only where nobody else uses it. `volumes`: the one
    folder of machines that volumes may be in; empty where that is not known here. `remover`: the platform's account
    that may take away what no chart renders; empty where nobody may."""

    agents: tuple[str, ...]
    tests: tuple[str, ...]
    charts: str
    platform: str = "robotkube"
    gate: str = "robotkube-gate"
    argocd: str = "argocd"
    elsewhere: bool = False
    volumes: str = ""
    remover: str = REMOVER

    def __post_init__(self) -> None:
        """InputError names what is no name: policies are made of these words, so nothing else may stand in them."""
        for name in (*self.agents, *self.tests, self.platform, self.gate, self.argocd):
            if not NAME.fullmatch(name):
                raise InputError(f"admission: {name[:120]!r} is no name of a namespace")
        if self.remover and not NAME.fullmatch(self.remover):
            raise InputError(f"admission: {self.remover[:120]!r} is no name of a service account")
        if not CHARTS_URL.fullmatch(self.charts):
            raise InputError(f"admission: {self.charts[:200]!r} must be oci://<host>/<organisation>")
        if self.volumes and not FOLDER.fullmatch(self.volumes):
            raise InputError(f"admission: {self.volumes[:200]!r} must be an absolute folder, of plain characters")

    @property
    def of_the_platform(self) -> tuple[str, ...]:
        """Namespaces in which the platform's images run. Argo CD's counts where its images are known: where the whole
        cluster is ours."""
        return (self.platform, self.gate, *([self.argocd] if self.elsewhere else []))

    @property
    def application_controller(self) -> str:
        """The account that writes releases' workloads."""
        return account(self.argocd, APPLICATION_CONTROLLER)

    @property
    def generator(self) -> str:
        """The account that writes Applications."""
        return account(self.argocd, GENERATOR)

    @property
    def suite_runner(self) -> str:
        """The account that starts charts under test."""
        return account(self.platform, SUITE_RUNNER)

    @property
    def remover_account(self) -> str:
        """The account that takes away what no chart renders; empty, which is nobody's, where none may."""
        return account(self.platform, self.remover) if self.remover else ""


def account(namespace: str, name: str) -> str:
    """A service account as the API server names its user."""
    return f"system:serviceaccount:{namespace}:{name}"


def controllers(*names: str) -> tuple[str, ...]:
    """Accounts of the controller manager: one for each controller, or its own where it has no others."""
    return (*(account(CONTROLLERS, name) for name in names), "system:kube-controller-manager")
