"""Images without a registry: an archive in the folder from which k3s imports, and the wait until Nodes have them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ci.cluster.k3s.nodes import K3sNode
from ci.cluster.through_api_server.bundled_images import bundled
from ci.errors import InputError, SetUpError
from ci.images.image_lock import Image
from robotkube.registry.bundles.adapters.loading import load_k3s
from robotkube.registry.bundles.core.archives import mark

VARIABLE, FOLDER = "K3S_IMAGES", "/var/lib/rancher/k3s/agent/images"
NAME = "robotkube-demo-{}.tar"  # not that of `robotkube bundle load`, which a person put there
IMPORT_SECONDS_MAX = 600  # 0.8 GB, from a disk that may be slow; then a kubelet looks twice a minute
POLL_SECONDS = 2.0


def folder() -> Path:
    """The folder from which k3s imports; InputError where this process cannot write to it."""
    named = named_folder()
    if _may_write(named) and named.is_dir():
        return named
    raise InputError(
        f"{VARIABLE}={named}: is no folder that this process can write to; make it and run this as root (mkdir -p "
        f"{named}), name the folder from which this k3s imports, or bring the images to a registry: REGISTRY=HOST/PATH"
    )


def named_folder() -> Path:
    """That folder, whether it is there or not."""
    return Path(os.environ.get(VARIABLE) or FOLDER)


def archive(images: Sequence[Image]) -> Path:
    """The file that has these images: another name for others, since k3s imports a file of the same name and size once
    only."""
    return folder() / NAME.format(mark(image.reference for image in images))


def archives() -> tuple[Path, ...]:
    """Those that were put there, by this process or another, also what was left half written; none where it cannot
    look."""
    named = named_folder()
    return tuple(sorted(named.glob(f"{NAME.format('*')}*"))) if _may_write(named) else ()


def hidden() -> str:
    """What `archives` cannot see, in words; empty where it sees all. Whether a folder of root's is there at all, no
    other user knows."""
    if os.geteuid() == 0 or _may_write(named_folder()):
        return ""
    return f"{named_folder() / NAME.format('*')}, if root put one there: this process may not look"


def bring(images: Sequence[Image], work: Path, nodes: Callable[[], Sequence[K3sNode]]) -> None:
    """Put the images there, take earlier ones away, and wait until every Node says that it has them; SetUpError names
    the one that has not. `work`: a folder for the bundle meanwhile."""
    file = archive(images)
    if not file.exists():
        try:
            with bundled(images, work) as bundle:
                load_k3s(bundle, file.parent, file.name)
        except OSError as error:
            raise SetUpError(f"{file}: cannot be written: {error.strerror}") from error
    for other in archives():
        if other != file:
            other.unlink()
    references = [image.reference for image in images]
    deadline = time.monotonic() + IMPORT_SECONDS_MAX
    while waiting := [node for node in nodes() if node.lacking(references)]:
        if time.monotonic() > deadline:
            raise SetUpError(_not_imported(waiting[0], references, file))
        time.sleep(POLL_SECONDS)


def _may_write(place: Path) -> bool:
    return os.access(place, os.W_OK | os.X_OK)


def _not_imported(node: K3sNode, references: Sequence[str], file: Path) -> str:
    lacking = node.lacking(references)
    return (
        f"Node {node.name} ({node.version}): has not {lacking[0]} ({len(lacking)} of {len(references)} images), "
        f"{IMPORT_SECONDS_MAX:.0f} s after {file} was there; look into the log of k3s. One before 1.32 imports when it "
        f"starts alone: systemctl restart k3s. A Node that is a container needs this folder as its own {FOLDER}"
    )
