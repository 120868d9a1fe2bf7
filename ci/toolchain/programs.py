"""The programs of the embedded cluster: where each comes from, how it is stamped, and what proves that it runs.

Stamps matter: without `component-base/version.gitVersion` the API server says v0.0.0, without
`chartutil.k8sVersionMinor` helm assumes an old cluster.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
KUBERNETES = "k8s.io/kubernetes"
CONTAINERD = "github.com/containerd/containerd/v2"
ARGO_CD = "github.com/argoproj/argo-cd/v3"
HELM = "helm.sh/helm/v3"
ETCD = "go.etcd.io/etcd/server/v3"
COREDNS = "github.com/coredns/coredns"
RUNC = "github.com/opencontainers/runc"
GITEA = "code.gitea.io/gitea"
MODULES = (KUBERNETES, CONTAINERD, ARGO_CD, HELM, ETCD, COREDNS, RUNC)

Versions = Mapping[str, str]
Stamps = Mapping[str, str]


@dataclass(frozen=True)
class Program:
    """One binary. `links` are names beside it by which it is several programs; `smoke` maps a name to its arguments.

    `module` is the one whose version (without v) the answers to `smoke` must contain.
    """

    name: str
    module: str
    package: str
    smoke: Mapping[str, tuple[str, ...]]
    folder: Path = FOLDER
    links: tuple[str, ...] = ()
    tags: str = ""
    cgo: bool = False
    stamps: Callable[[Versions], Stamps] = lambda _: {}


def kubernetes_stamps(versions: Versions) -> Stamps:
    """Version of Kubernetes' programs and of their API client."""
    version = versions[KUBERNETES]
    major, minor = version.removeprefix("v").split(".")[:2]
    fields = {"gitVersion": version, "gitMajor": major, "gitMinor": minor, "gitTreeState": "clean"}
    packages = ("k8s.io/component-base/version", "k8s.io/client-go/pkg/version")
    return {f"{package}.{field}": value for package in packages for field, value in fields.items()}


def helm_stamps(versions: Versions) -> Stamps:
    """helm's version, and the Kubernetes version it assumes when it renders without a cluster."""
    major, minor = versions[KUBERNETES].removeprefix("v").split(".")[:2]
    assumed = {
        f"{HELM}/pkg/{package}.k8sVersion{part}": value
        for package in ("chartutil", "lint/rules")
        for part, value in (("Major", major), ("Minor", minor))
    }
    return {f"{HELM}/internal/version.version": versions[HELM]} | assumed


VERSION = ("--version",)
KUBERNETES_LINKS = (
    "kubectl",
    "kubelet",
    "kube-apiserver",
    "kube-controller-manager",
    "kube-proxy",
    "kube-scheduler",
)
ARGO_CD_LINKS = tuple(
    f"argocd-{name}"
    for name in (
        "server",
        "repo-server",
        "application-controller",
        "applicationset-controller",
        "cmp-server",
        "notifications",
        "dex",
        "k8s-auth",
        "git-ask-pass",
        "commit-server",
    )
)
NO_CGO_SNAPSHOTTERS = "no_btrfs,no_devmapper,no_zfs"

PROGRAMS = (
    Program(
        "kubernetes",
        KUBERNETES,
        "./cmd/kubernetes",
        {name: VERSION for name in KUBERNETES_LINKS if name != "kubectl"} | {"kubectl": ("version", "--client")},
        links=KUBERNETES_LINKS,
        stamps=kubernetes_stamps,
    ),
    Program("etcd", ETCD, ETCD, {"etcd": VERSION}),
    Program(
        "containerd",
        CONTAINERD,
        f"{CONTAINERD}/cmd/containerd",
        {"containerd": VERSION},
        tags=NO_CGO_SNAPSHOTTERS,
        stamps=lambda versions: {f"{CONTAINERD}/version.Version": versions[CONTAINERD]},
    ),
    Program(
        "containerd-shim-runc-v2",
        CONTAINERD,
        f"{CONTAINERD}/cmd/containerd-shim-runc-v2",
        {"containerd-shim-runc-v2": ("-v",)},
        tags=NO_CGO_SNAPSHOTTERS,
        stamps=lambda versions: {f"{CONTAINERD}/version.Version": versions[CONTAINERD]},
    ),
    Program(
        "ctr",
        CONTAINERD,
        f"{CONTAINERD}/cmd/ctr",
        {"ctr": VERSION},
        tags=NO_CGO_SNAPSHOTTERS,
        stamps=lambda versions: {f"{CONTAINERD}/version.Version": versions[CONTAINERD]},
    ),
    # cgo: its C part enters the namespaces before Go starts threads
    Program(
        "runc",
        RUNC,
        RUNC,
        {"runc": VERSION},
        tags="seccomp",
        cgo=True,
        stamps=lambda versions: {"main.version": versions[RUNC].removeprefix("v")},
    ),
    Program("coredns", COREDNS, COREDNS, {"coredns": ("-version",)}),
    Program("helm", HELM, f"{HELM}/cmd/helm", {"helm": ("version",)}, stamps=helm_stamps),
    Program(
        "chart-renderer",
        HELM,
        "./cmd/chart-renderer",
        {"chart-renderer": VERSION},
        stamps=lambda versions: {**helm_stamps(versions), "main.version": versions[HELM]},
    ),
    Program(
        "argocd",
        ARGO_CD,
        f"{ARGO_CD}/cmd",
        {"argocd": ("version", "--client", "--short")},
        links=ARGO_CD_LINKS,
        stamps=lambda versions: {f"{ARGO_CD}/common.version": versions[ARGO_CD].removeprefix("v")},
    ),
    # own module: it shares few versions with the others; cgo: SQLite
    Program(
        "gitea",
        GITEA,
        GITEA,
        {"gitea": VERSION},
        folder=FOLDER / "gitea",
        tags="sqlite,sqlite_unlock_notify",
        cgo=True,
        stamps=lambda versions: {"main.Version": versions[GITEA].removeprefix("v")},
    ),
    Program(
        "forge-hook",
        GITEA,
        "./forge-hook",
        {"forge-hook": VERSION},
        folder=FOLDER / "gitea",
        stamps=lambda versions: {"main.version": versions[GITEA].removeprefix("v")},
    ),
)
