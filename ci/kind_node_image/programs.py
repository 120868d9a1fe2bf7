"""What an image of nodes has besides the tool chain's programs: kubeadm, of the same Kubernetes, and what makes volumes
of folders of nodes. Only this image is made of them."""

from __future__ import annotations

from pathlib import Path

from ci.toolchain.kept import Kept
from ci.toolchain.programs import (
    KUBERNETES,
    VERSION,
    Program,
    Stamps,
    Versions,
    kubernetes_stamps,
)

FOLDER = Path(__file__).resolve().parent
PROVISIONER = "github.com/rancher/local-path-provisioner"

KUBEADM = (
    Program(
        "kubeadm",
        KUBERNETES,
        f"{KUBERNETES}/cmd/kubeadm",
        {"kubeadm": ("version", "--output", "short")},
        folder=FOLDER / "kubeadm",
        stamps=kubernetes_stamps,
    ),
)


def provisioner_stamps(versions: Versions) -> Stamps:
    """The version that it says."""
    return {"main.VERSION": versions[PROVISIONER]}


VOLUMES = (
    Program(
        "local-path-provisioner",
        PROVISIONER,
        PROVISIONER,
        {"local-path-provisioner": VERSION},
        folder=FOLDER / "local_path_provisioner",
        stamps=provisioner_stamps,
    ),
)


def kubeadm() -> Path:
    """The program, built if the cache lacks it; SetUpError."""
    return Kept("kubeadm", KUBEADM[0].folder, KUBERNETES, KUBEADM).ensure() / "kubeadm"


def provisioner() -> Path:
    """The program, built if the cache lacks it; SetUpError."""
    return Kept("local-path-provisioner", VOLUMES[0].folder, PROVISIONER, VOLUMES).ensure() / "local-path-provisioner"
