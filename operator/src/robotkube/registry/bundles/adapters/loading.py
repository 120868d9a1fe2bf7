"""A bundle's images brought to where containers start, without a registry: a kind cluster, the folder that k3s imports,
the containerd of this machine. They are known there by the references that the bundle's charts have."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from robotkube.errors import InputError, UnavailableError
from robotkube.registry.bundles.adapters.layouts import Bundle, Layout
from robotkube.registry.bundles.core.archives import archive_name, is_archive
from robotkube.registry.bundles.core.contents import IMAGE

CONTAINERD_NAME = "io.containerd.image.name"  # what an import calls an image
# kind has containerd keep the archive's index as well, as a further name of its first image, and by that name kubelets
# cannot start it. No pod runs this one: kind's nodes have another for sandboxes.
FIRST = "pause"
LOAD_SECONDS_MAX = 1800
WORDS_MAX = 1500


def write_images(bundle: Bundle, archive: Path) -> None:
    """Write an OCI layout archive of the images alone: a runtime cannot import charts and evidence."""
    layout = Layout()
    references = bundle.contents.references()
    for item in sorted(bundle.contents.of(IMAGE), key=lambda item: item.name != FIRST):
        layout.blobs |= {digest: bundle.blobs[digest] for digest in (item.digest, *bundle.parts(item.digest))}
        layout.name(item.digest, **{CONTAINERD_NAME: references[item.name]})
    layout.write(archive)


def load_kind(bundle: Bundle, cluster: str, program: str = "kind") -> str:
    """Load into every node of a kind cluster; where that is."""
    with _archive(bundle) as archive:
        _run([program, "load", "image-archive", str(archive), "--name", cluster])
    return f"kind cluster {cluster}"


def load_k3s(bundle: Bundle, folder: Path, name: str = "") -> Path:
    """Put them into the folder from which k3s imports, as a file of this name or of one that follows from version and
    images; where that is. A file is there whole or not at all."""
    if not folder.is_dir():
        raise InputError(
            f"--k3s {folder}: no such folder; on a node it is /var/lib/rancher/k3s/agent/images (make it, k3s reads it)"
        )
    archive = folder / (name or archive_name(bundle.contents))
    write_images(bundle, archive)
    return archive


def others_of_k3s(archive: Path) -> list[Path]:
    """The archives beside this one that earlier loads have left: k3s imports them as well, at each of its starts."""
    beside = (file for file in archive.parent.iterdir() if is_archive(file.name) and file != archive)
    return sorted(file for file in beside if file.is_file())


def load_containerd(bundle: Bundle, address: str) -> str:
    """Import into the containerd of this machine, where its kubelet looks; where that is."""
    ctr = ["ctr", "--address", address, "--namespace", "k8s.io", "images", "import"]
    local = ["--local"] if "--local" in _run([*ctr, "--help"]) else []  # the other way renames what has a digest
    with _archive(bundle) as archive:
        _run([*ctr, *local, str(archive)])
    return f"containerd at {address}"


@contextmanager
def _archive(bundle: Bundle) -> Iterator[Path]:
    """The images for the time of an import: as large as all of them."""
    with tempfile.TemporaryDirectory(prefix="robotkube-bundle-", dir=bundle.path.parent) as folder:
        archive = Path(folder) / "images.tar"
        write_images(bundle, archive)
        yield archive


def _run(command: Sequence[str]) -> str:
    """What a program prints; its words when it fails."""
    program = shutil.which(command[0])
    if program is None:
        raise InputError(f"{command[0]} is not on PATH")
    try:
        done = subprocess.run(
            [program, *command[1:]], capture_output=True, text=True, timeout=LOAD_SECONDS_MAX, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise UnavailableError(f"{' '.join(command[:3])}: no end within {LOAD_SECONDS_MAX} s") from error
    if done.returncode:
        raise UnavailableError(f"{' '.join(command[:3])}: {(done.stderr or done.stdout).strip()[-WORDS_MAX:]}")
    return done.stdout
