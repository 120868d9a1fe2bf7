"""What the image is called: by the version of Kubernetes in it, and by all that it is made of. Another one of either
has another name, so a cluster is made anew for it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ci import kind_cli, toolchain
from ci.folders import PROJECT, user_cache
from ci.kind_node_image import root_folder
from ci.toolchain import go
from ci.toolchain.programs import FOLDER as TOOLCHAIN
from ci.toolchain.programs import KUBERNETES

FOLDER = Path(__file__).resolve().parent
PAUSE = PROJECT / "operator" / "images" / "pause" / "pause.c"
REPOSITORY = "localhost/robotkube-kind-node"
KEY_LENGTH = 12
MAKING = ("archives.py", "building.py", "component_images.py", "node.py", "programs.py", "root_folder.py")
INPUTS = (*MAKING, "join-nodes", "manifests/*.yaml", "*/go.mod", "*/go.sum", "*/tools.go")
"""Files in this folder of which the image depends."""


def kubernetes_version() -> str:
    """Of the tool chain, with its v."""
    return go.module_version(TOOLCHAIN, KUBERNETES)


def key() -> str:
    """What two images that are the same have in common, but for the state of Debian's packages."""
    files = {path for pattern in INPUTS for path in FOLDER.glob(pattern)}
    digest = hashlib.sha256(f"{toolchain.key()}\n{root_folder.key()}".encode())
    for path in [*sorted(files), kind_cli.FOLDER / "go.mod", PAUSE]:
        digest.update(f"\n{path.name}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:KEY_LENGTH]


def reference() -> str:
    """NAME:TAG, as Docker, podman and kind know it."""
    return f"{REPOSITORY}:{kubernetes_version()}-{key()}"


def cache_folder() -> Path:
    """Where it is kept, with what it is made of."""
    return user_cache() / "kind-node-image"
