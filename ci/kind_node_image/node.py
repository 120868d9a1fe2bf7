"""A node's root folder made of Debian's: what kind's own base image and its build add, from the files in kind's module.

images/base/Dockerfile and pkg/build/nodeimage of kind say what that is.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ci.errors import SetUpError
from ci.kind_node_image.component_images import Parts
from ci.kind_node_image.naming import FOLDER

SETTINGS = "etc/containerd/config.toml"
UNITS = "lib/systemd/system"
UNWANTED = (
    f"{UNITS}/sysinit.target.wants/systemd-tmpfiles-setup.service",
    f"{UNITS}/multi-user.target.wants/*",
    f"{UNITS}/local-fs.target.wants/*",
    f"{UNITS}/sockets.target.wants/*udev*",
    f"{UNITS}/sockets.target.wants/*initctl*",
    f"{UNITS}/basic.target.wants/*",
    "etc/systemd/system/*.wants/*",
)
EMPTIED = (
    "var/lib/apt/lists",
    "var/cache/apt",
    "var/log",
    "usr/share/doc",
    "usr/share/man",
    "usr/share/locale",
    "tmp",
)
PLUGINS = ("host-local", "loopback", "portmap", "ptp")
HOOK = "/kind/bin/mount-product-files.sh"
ASKED_SECONDS_MAX = 60
START_SECONDS_MAX = 30
IMPORT_SECONDS_MAX = 300
POLL_SECONDS = 0.1


def furnish(root: Path, base: Path, parts: Parts, version: str) -> None:
    """Make a node of a root folder with Debian; `base` is the folder of files in kind's module."""
    _copy_base(base, root)
    _choose_services(root)
    _copy_programs(root, parts)
    specification = json.loads(_said(str(parts.binaries / "ctr"), "oci", "spec"))
    specification.setdefault("hooks", {}).setdefault("createContainer", []).append({"path": HOOK})
    specification["process"].pop("rlimits", None)
    (root / "etc/containerd/cri-base.json").write_text(json.dumps(specification), encoding="utf-8")
    _let_scores_be(root / SETTINGS)
    (root / "kind/version").write_text(version, encoding="utf-8")
    shutil.copytree(FOLDER / "manifests", root / "kind/manifests")
    (root / "etc/kubernetes/manifests").mkdir(parents=True)


def _copy_base(base: Path, root: Path) -> None:
    """kind's files: those below a folder bin are programs. A module's files cannot be written."""
    for file in sorted(path for path in base.rglob("*") if path.is_file()):
        target = root / file.relative_to(base)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, target)
        target.chmod(0o755 if file.parent.name == "bin" else 0o644)


def _choose_services(root: Path) -> None:
    for pattern in UNWANTED:
        for path in root.glob(pattern):
            path.unlink()
    with (root / "etc/systemd/journald.conf").open("a", encoding="utf-8") as file:
        file.write("ReadKMsg=no\n")
    initial = root / "sbin/init"
    initial.unlink(missing_ok=True)
    initial.symlink_to("/usr/lib/systemd/systemd")
    enabled = ("kubelet.service", "containerd.service", "undo-mount-hacks.service")
    _said("chroot", str(root), "systemctl", "enable", *enabled)
    _said("chroot", str(root), "systemctl", "mask", "systemd-binfmt.service")  # it writes to the kernel of all


def _copy_programs(root: Path, parts: Parts) -> None:
    local = root / "usr/local"
    for name in ("containerd", "containerd-shim-runc-v2", "ctr"):
        shutil.copy2(parts.binaries / name, local / "bin" / name)
    shutil.copy2(parts.binaries / "runc", local / "sbin/runc")
    shutil.copy2(parts.binaries / "kubernetes", root / "usr/bin/kubernetes")
    shutil.copy2(parts.kubeadm, root / "usr/bin/kubeadm")
    for name in ("kubelet", "kubectl"):
        (root / "usr/bin" / name).symlink_to("kubernetes")
    plugins = root / "opt/cni/bin"
    plugins.mkdir(parents=True)
    for name in PLUGINS:
        shutil.move(root / "usr/lib/cni" / name, plugins / name)
    shutil.rmtree(root / "usr/lib/cni")


def _let_scores_be(settings: Path) -> None:
    """Some machines and engines withhold the capability to lower what a process is worth when memory is short."""
    text = settings.read_text(encoding="utf-8")
    changed = text.replace("restrict_oom_score_adj = false", "restrict_oom_score_adj = true")
    if changed == text:
        raise SetUpError(f"{SETTINGS} of kind has no restrict_oom_score_adj: this version of kind is not known here")
    settings.write_text(changed, encoding="utf-8")


def preload(root: Path, archive: Path, binaries: Path) -> None:
    """Import images into the node's own containerd, as kind does: not unpacked, which each node does itself."""
    with _containerd(root / "var/lib/containerd", binaries) as socket:
        ctr = [
            str(binaries / "ctr"),
            "--address",
            str(socket),
            "--namespace",
            "k8s.io",
            "images",
        ]
        words = [
            "--local",
            "--all-platforms",
            "--no-unpack",
            "--label=io.cri-containerd.pinned=pinned",
        ]
        _said(*ctr, "import", *words, str(archive), seconds=IMPORT_SECONDS_MAX)


@contextmanager
def _containerd(place: Path, binaries: Path) -> Iterator[Path]:
    """One that runs for as long as the block lasts, with its root folder there; its socket."""
    with tempfile.TemporaryDirectory(prefix="robotkube-containerd-") as folder:
        socket = Path(folder, "socket")
        file = Path(folder, "config.toml")
        disabled = [
            f"io.containerd.{name}" for name in ("cri.v1.images", "cri.v1.runtime", "grpc.v1.cri", "nri.v1.nri")
        ]
        lines = [
            "version = 3",
            f'root = "{place}"',
            f'state = "{folder}/state"',
            f"disabled_plugins = {disabled}",
        ]
        lines += [
            "[grpc]",
            f'address = "{socket}"',
            "[ttrpc]",
            f'address = "{folder}/ttrpc"',
            "",
        ]
        file.write_text("\n".join(lines), encoding="utf-8")
        with Path(folder, "log").open("w+", encoding="utf-8") as log:
            process = subprocess.Popen([binaries / "containerd", "--config", file], stdout=log, stderr=log)
            try:
                _wait(
                    process,
                    [str(binaries / "ctr"), "--address", str(socket), "version"],
                    Path(log.name),
                )
                yield socket
            finally:
                process.terminate()
                process.wait(START_SECONDS_MAX)


def _wait(process: subprocess.Popen[bytes], question: list[str], log: Path) -> None:
    end = time.monotonic() + START_SECONDS_MAX
    while process.poll() is None and time.monotonic() < end:
        if subprocess.run(question, capture_output=True, timeout=ASKED_SECONDS_MAX, check=False).returncode == 0:
            return
        time.sleep(POLL_SECONDS)
    raise SetUpError(f"containerd does not answer within {START_SECONDS_MAX} s: {log.read_text()[-1000:]}")


def empty(root: Path) -> None:
    """Take away what no node needs."""
    for name in EMPTIED:
        for path in (root / name).glob("*"):
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def _said(*command: str, seconds: int = ASKED_SECONDS_MAX) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
    if done.returncode:
        raise SetUpError(f"{' '.join(command[:3])}: {(done.stderr or done.stdout).strip()[-1000:]}")
    return done.stdout
