"""The images that a kubeadm cluster starts with: Kubernetes, etcd and CoreDNS of the tool chain, the process of
sandboxes, and what kind adds, a network of pods and volumes.

All programs of Kubernetes are one file, so their four images, and that of the network, have the same two layers.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ci.errors import SetUpError
from ci.kind_node_image.archives import SAME, MadeImage, MadeLayer, layer, stored
from ci.kind_node_image.naming import FOLDER, PAUSE

NETWORK = "localhost/robotkube-kind-network:1"
PROVISIONER = "localhost/robotkube-kind-volumes:1"
KUBERNETES = (
    "kube-apiserver",
    "kube-controller-manager",
    "kube-scheduler",
    "kube-proxy",
)
NAMED = (*KUBERNETES, "kubectl")
# what the network's script, the script of volumes and kube-proxy call
CALLED = (
    "/bin/sh",
    *(f"/usr/bin/{name}" for name in ("cat", "mkdir", "mv", "rm", "sh", "sleep")),
    *(f"/usr/sbin/{name}" for name in ("ip", "nft")),
    *(f"/usr/sbin/{prefix}{name}" for prefix in ("iptables", "ip6tables") for name in ("", "-save", "-restore")),
)
EXTENSIONS = "usr/lib/x86_64-linux-gnu/xtables"  # of iptables, which opens them when it runs
EMPTY = ("/run", "/tmp")  # noqa: S108 - folders of an image
LIBRARY = re.compile(r"(/\S+) \(0x")
PATH = "PATH=/usr/local/bin:/usr/sbin:/usr/bin"
ASKED_SECONDS_MAX = 60
SANDBOX = re.compile(r'^\s*sandbox_image = "(\S+)"', re.MULTILINE)


@dataclass(frozen=True)
class Parts:
    """What images are made of: the tool chain's folder, two programs more, and Debian's root folder."""

    binaries: Path
    kubeadm: Path
    provisioner: Path
    root: Path


def component_images(parts: Parts, version: str, sandbox: str, folder: Path) -> Iterator[MadeImage]:
    """All of them, with their layers in `folder`; `sandbox` is what nodes call the image of sandboxes."""
    wanted = required(parts.kubeadm, version)
    userland = _userland(parts.root, folder / "userland.gz")
    shared = {
        "kubernetes": parts.binaries / "kubernetes",
        "join-nodes": FOLDER / "join-nodes",
    }
    kubernetes = _programs(folder / "kubernetes", shared, NAMED)
    provisioner = _programs(folder / "provisioner", {"local-path-provisioner": parts.provisioner})
    names = tuple(name for name in wanted if name.rpartition("/")[2].startswith(KUBERNETES))
    yield MadeImage((*names, NETWORK), (userland, kubernetes), {"Env": [PATH]})
    yield MadeImage((PROVISIONER,), (userland, provisioner), {"Env": [PATH]})
    for name, settings in (
        ("etcd", {"Env": [PATH]}),
        ("coredns", {"Entrypoint": ["/usr/local/bin/coredns"]}),
    ):
        called = next(one for one in wanted if f"/{name}:" in one)
        yield MadeImage(
            (called,),
            (_programs(folder / name, {name: parts.binaries / name}),),
            settings,
        )
    yield MadeImage((sandbox,), (_pause(folder),), {"Entrypoint": ["/pause"]})


def required(kubeadm: Path, version: str) -> list[str]:
    """The names of the images that kubeadm asks for."""
    return _said(str(kubeadm), "config", "images", "list", "--kubernetes-version", version).split()


def sandbox_image(containerd_settings: str) -> str:
    """What kind's settings of containerd call the image of sandboxes."""
    found = SANDBOX.search(containerd_settings)
    if found is None:
        raise SetUpError("kind's settings of containerd name no sandbox_image: this version of kind is not known here")
    return found[1]


def _programs(folder: Path, files: Mapping[str, Path], links: Iterable[str] = ()) -> MadeLayer:
    """A layer with programs, and links to the first of them."""
    place = folder / "usr" / "local" / "bin"
    place.mkdir(parents=True)
    for name, file in files.items():
        shutil.copyfile(file, place / name)
        (place / name).chmod(0o755)
    for link in links:
        (place / link).symlink_to(next(iter(files)))
    made = layer(folder, folder.with_suffix(".gz"))
    shutil.rmtree(folder)
    return made


def _userland(root: Path, file: Path) -> MadeLayer:
    """Programs of Debian with all libraries that they are linked with, each under the name by which it is found."""
    extensions = [f"/{path.relative_to(root)}" for path in sorted((root / EXTENSIONS).glob("*.so"))]
    linked = LIBRARY.findall(_said("chroot", str(root), "ldd", *CALLED, *extensions))
    names = sorted(name[1:] for name in {*CALLED, *extensions, *linked, *EMPTY})
    words = ["--dereference", "--no-recursion", *SAME, "-c", *names]
    return stored(["chroot", str(root), "tar", *words], file, compressed=True)


def _pause(folder: Path) -> MadeLayer:
    """The process that holds a pod's namespaces, the same as in the platform's own image."""
    place = folder / "pause"
    place.mkdir()
    _said(
        "gcc",
        "-Os",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-static",
        "-s",
        "-o",
        str(place / "pause"),
        str(PAUSE),
    )
    return layer(place, folder / "pause.gz")


def _said(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=ASKED_SECONDS_MAX, check=False)
    if done.returncode:
        raise SetUpError(f"{' '.join(command[:3])}: {(done.stderr or done.stdout).strip()[-1000:]}")
    return done.stdout
