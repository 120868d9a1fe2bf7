"""Images without pulling: imported once into a containerd root folder that every node then starts from.

    <cache>/imported/<key>/       containerd's root with all images of one lock file, never written again
    <node>/containerd/            the node's own root: copies of the databases, hard links to the archives' contents,
                                  and for every unpacked layer a link to the imported one (overlay only reads it)

Importing 565 MB takes half a minute, starting a node from it a tenth of a second and no space. What a root that is kept
has already is not imported again: the new root starts as a copy of the one that has most of the images, with links for
what containerd never writes again, and ends with exactly its own.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

from ci.cluster.embedded.host.processes import Launcher, Process, wait_until
from ci.cluster.embedded.nodes import containerd
from ci.errors import SetUpError
from ci.folders import user_cache
from ci.images.image_lock import Image, sandbox_of

SCHEME = "2"  # changes when this module lays the folder out differently
PARTIAL = ".partial"  # of a root that is being made
RECORD = "imported.json"  # in an imported root: its references, and by what it was made
IMPORT_TIMEOUT_SECONDS = 300
START_TIMEOUT_SECONDS = 30
KEPT_ROOTS = 2
SNAPSHOTS = Path("io.containerd.snapshotter.v1.overlayfs/snapshots")


def key_of(images: Iterable[Image], maker: str) -> str:
    """The key of an imported root: all references, and what makes it."""
    parts = [maker, *sorted(image.reference for image in images)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def maker_of(binaries: Path) -> str:
    """What makes an imported root: containerd's own version and this module's scheme."""
    command = [str(binaries / "containerd"), "--version"]
    version = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    return f"{SCHEME} {version}"


def imported(images: Sequence[Image], launcher: Launcher) -> tuple[Path, int]:
    """The imported root of these images, and how many had to be imported for it; none when it is in the cache."""
    base = user_cache() / "imported"
    maker = maker_of(launcher.binaries)
    root = base / key_of(images, maker)
    if root.is_dir():
        os.utime(root)
        return root, 0
    partial = root.with_suffix(PARTIAL)
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    former = _closest(base, images, maker)
    if former:
        _copy(former, partial)
    count = _import_into(partial, images, launcher)
    record = {"maker": maker, "references": sorted(image.reference for image in images)}
    (partial / RECORD).write_text(json.dumps(record), encoding="utf-8")
    partial.rename(root)
    _prune(base)
    return root, count


def _closest(base: Path, images: Iterable[Image], maker: str) -> Path | None:
    """Of the kept roots that the same has made the one with the most of these images; None when no root has one."""
    wanted = {image.reference for image in images}
    shared = {}
    for path in base.glob(f"*/{RECORD}"):
        if path.parent.suffix == PARTIAL:  # of a start that was killed
            continue
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["maker"] == maker:
            shared[path.parent] = len(wanted.intersection(record["references"]))
    closest = max(shared, key=lambda root: shared[root], default=None)
    return closest if closest and shared[closest] else None


def _copy(root: Path, target: Path) -> None:
    """Make `target` the same root: links to contents and layers, which are never written again, copies of the rest."""
    command = ["cp", "--archive", "--link", f"{root}/.", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=IMPORT_TIMEOUT_SECONDS, check=False)
    if done.returncode:
        raise SetUpError(f"{root}: cannot be copied to {target}: {done.stderr.strip()[-400:]}")
    (target / RECORD).unlink()
    for folder, folders, files in os.walk(target):
        folders[:] = [name for name in folders if name not in (SNAPSHOTS.name, "blobs")]
        for file in files:
            copy = Path(folder, f"{file}.copy")
            shutil.copy2(Path(folder, file), copy)
            copy.replace(Path(folder, file))


def _import_into(root: Path, images: Sequence[Image], launcher: Launcher) -> int:
    """Import what of the images a root does not have, and take away what else it has; how many were imported."""
    state = launcher.folders.base / "import"
    state.mkdir(parents=True, exist_ok=True)
    runc = launcher.binaries / "runc"
    settings = containerd.ContainerdSettings(root, state, sandbox_of(images), runc, state, state / "certs.d")
    configuration = state / "containerd.toml"
    configuration.write_text(settings.toml(), encoding="utf-8")
    prefix = ["/usr/bin/unshare", "--mount", "--propagation", "private"]
    process = launcher.start("import", ["containerd", "--config", str(configuration)], prefix)
    socket = state / "containerd.sock"
    try:
        wait_until(lambda: serving(socket, launcher.binaries), "containerd", START_TIMEOUT_SECONDS, [process])
        known = listed(socket, launcher.binaries)
        new = [image for image in images if image.reference not in known]
        for image in sorted(new, key=lambda image: image.ground is not None):  # what others are cut from first
            import_one(image, socket, launcher.binaries)
        _remove_others(images, socket, launcher.binaries)
    finally:
        _stop(process)
    (launcher.folders.processes / "import.json").unlink(missing_ok=True)
    shutil.rmtree(state, ignore_errors=True)
    return len(new)


def _remove_others(images: Iterable[Image], socket: Path, binaries: Path) -> None:
    """Take away what is none of these images, with its layers; containerd's own names for one go with it."""
    wanted = {image.reference.partition("@")[2] for image in images}
    others = [name for name, digest in listed(socket, binaries).items() if digest not in wanted]
    if others:
        _ctr(socket, binaries, "remove", "--sync", *others)


def listed(socket: Path, binaries: Path) -> dict[str, str]:
    """The images that containerd knows: name -> digest of the manifest."""
    lines = _ctr(socket, binaries, "list").splitlines()[1:]
    return {name: digest for name, _, digest, *_ in map(str.split, lines)}


def _ctr(socket: Path, binaries: Path, *words: str) -> str:
    command = [str(binaries / "ctr"), "--address", str(socket), "--namespace", "k8s.io", "images", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=IMPORT_TIMEOUT_SECONDS, check=False)
    if done.returncode:
        raise SetUpError(f"containerd: images {words[0]}: {done.stderr.strip()[-400:]}")
    return done.stdout


def serving(socket: Path, binaries: Path) -> bool:
    """Return whether containerd answers on `socket`."""
    if not socket.exists():
        return False
    command = [str(binaries / "ctr"), "--address", str(socket), "version"]
    return subprocess.run(command, capture_output=True, timeout=10, check=False).returncode == 0


def import_one(image: Image, socket: Path, binaries: Path) -> None:
    """Import one archive; containerd knows it by its digest reference afterwards, or SetUpError says so. An image with
    a ground needs the image it was cut from to be there."""
    options = ["--local", "--digests", "--base-name", image.repository]
    try:
        _ctr(socket, binaries, "import", *options, str(image.archive))
    except SetUpError as error:
        raise SetUpError(f"{image.archive}: cannot be imported: {error}") from error
    if image.reference not in listed(socket, binaries):
        raise SetUpError(f"{image.archive}: does not contain {image.reference}; build the images again: make images")


def _stop(process: Process) -> None:
    deadline = time.monotonic() + START_TIMEOUT_SECONDS
    if process.alive():
        os.kill(process.pid, 15)
    while process.alive() and time.monotonic() < deadline:
        time.sleep(0.05)
    if process.alive():
        os.kill(process.pid, 9)


def clone(imported_root: Path, target: Path) -> None:
    """Make `target` a containerd root with the imported images; nothing of it may run yet."""
    for folder, _, files in os.walk(imported_root):
        relative = Path(folder).relative_to(imported_root)
        if relative == SNAPSHOTS:
            _link_layers(Path(folder), target / SNAPSHOTS)
        if SNAPSHOTS in (relative, *relative.parents):
            continue
        (target / relative).mkdir(parents=True, exist_ok=True)
        for file in files:
            source, copy = Path(folder) / file, target / relative / file
            if "blobs" in relative.parts:
                os.link(source, copy)
            else:
                shutil.copy2(source, copy)


def _link_layers(source: Path, target: Path) -> None:
    target.mkdir(parents=True)
    for snapshot in source.iterdir():
        (target / snapshot.name).mkdir()
        (target / snapshot.name / "fs").symlink_to(snapshot / "fs")


def _prune(base: Path) -> None:
    roots = sorted(base.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
    for old in roots[KEPT_ROOTS:]:
        shutil.rmtree(old, ignore_errors=True)
