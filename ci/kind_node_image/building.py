"""The image as an archive in the user's cache, made when it is not there.

<cache>/kind-node-image/debian-<key>.tar        Debian's packages
<cache>/kind-node-image/<tag>.tar               the image, as `docker save` would write it
"""

from __future__ import annotations

import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

from ci import kind_cli, packages
from ci.errors import SetUpError
from ci.kind_node_image import naming, programs, root_folder
from ci.kind_node_image.archives import MadeImage, whole_layer, write
from ci.kind_node_image.component_images import Parts, component_images, sandbox_image
from ci.kind_node_image.node import SETTINGS, empty, furnish, preload
from ci.machine import preparing
from ci.steps import Steps
from ci.toolchain import go

STEPS = 5
MACHINE = "x86_64"
FREE_BYTES_MIN = 5_000_000_000
UNPACKED_SECONDS_MAX = 300
# as in kind's own: it tells systemd where it is, systemd ends on this signal alone
SETTINGS_OF_NODES = {
    "Env": [
        "container=docker",
        "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
    ],
    "Entrypoint": ["/usr/local/bin/entrypoint", "/sbin/init"],
    "StopSignal": "SIGRTMIN+3",
}


def ensure() -> Path:
    """The archive; SetUpError or BuildError says what is missing or went wrong."""
    if platform.machine() != MACHINE:
        raise SetUpError(f"the image of nodes is built for {MACHINE} alone, and this is {platform.machine()}")
    binaries = preparing.tool_chain()
    packages.ensure("toolchain", "images")
    reference = naming.reference()
    target = naming.cache_folder() / f"{reference.rpartition(':')[2]}.tar"
    if target.is_file():
        return target
    folder = target.parent
    folder.mkdir(parents=True, exist_ok=True)
    _require_space(folder)
    steps = Steps(STEPS)
    with steps.step("kubeadm"):
        kubeadm = programs.kubeadm()
    with steps.step("provisioner of volumes"):
        provisioner = programs.provisioner()
    with steps.step("Debian's packages"):
        debian = root_folder.ensure(folder, folder / "build.log")
    with tempfile.TemporaryDirectory(dir=folder, prefix=".making-") as made:
        root = Path(made) / "root"
        with steps.step("root folder and images of components") as step:
            _unpack(debian, root)
            images = _furnish(Parts(binaries, kubeadm, provisioner, root), Path(made))
            step.note = f"{len(images)} images"
        with steps.step("image of nodes") as step:
            part = _pack(root, reference, Path(made))
            step.note = f"{part.stat().st_size / 1e6:.0f} MB"
        for older in folder.glob("v*.tar"):
            older.unlink()
        return part.rename(target)


def _require_space(folder: Path) -> None:
    free = shutil.disk_usage(folder).free
    if free < FREE_BYTES_MIN:
        raise SetUpError(
            f"{folder}: {free / 1e9:.1f} GB free, making the image of nodes needs {FREE_BYTES_MIN / 1e9:.0f} GB "
            "(choose another place with XDG_CACHE_HOME)"
        )


def _unpack(archive: Path, root: Path) -> None:
    root.mkdir(mode=0o755)
    words = [
        "--numeric-owner",
        "--xattrs",
        "--xattrs-include=*",
        "--exclude=./dev/*",
        "-xpf",
        str(archive),
    ]
    done = subprocess.run(
        ["tar", "-C", str(root), *words],
        capture_output=True,
        text=True,
        timeout=UNPACKED_SECONDS_MAX,
        check=False,
    )
    if done.returncode:
        raise SetUpError(f"{archive} cannot be unpacked: {done.stderr.strip()[-500:]}; delete it and try again")


def _furnish(parts: Parts, folder: Path) -> list[MadeImage]:
    """Make a node of the root folder, with the images of components in it; these."""
    base = go.module_folder(kind_cli.FOLDER, kind_cli.MODULE) / "images" / "base" / "files"
    sandbox = sandbox_image((base / SETTINGS).read_text(encoding="utf-8"))
    version = naming.kubernetes_version()
    layers = folder / "layers"
    layers.mkdir()
    images = list(component_images(parts, version, sandbox, layers))
    write(folder / "components.tar", images)
    shutil.rmtree(layers)
    furnish(parts.root, base, parts, version)
    preload(parts.root, folder / "components.tar", parts.binaries)
    empty(parts.root)
    return images


def _pack(root: Path, reference: str, folder: Path) -> Path:
    layer = whole_layer(root, folder / "layer.tar")
    shutil.rmtree(root)
    archive = folder / "image.tar"
    write(archive, [MadeImage((reference,), (layer,), SETTINGS_OF_NODES)])
    layer.file.unlink()
    return archive
