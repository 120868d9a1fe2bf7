"""Images as files, without an engine: layers of folders, and archives of images that Docker, podman and containerd load
(the form of `docker save`)."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import subprocess
import tarfile
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from ci.errors import SetUpError

BLOCK_BYTES = 2**20
ENDED_SECONDS_MAX = 60  # after it has written all
FASTEST = 1  # of gzip: nodes unpack more often than images are made
SAME = ("--sort=name", "--mtime=@0", "--owner=0", "--group=0", "--numeric-owner")


@dataclass(frozen=True)
class MadeLayer:
    """A layer in a file; `digest` is that of its content, as it is when unpacked."""

    file: Path
    digest: str


@dataclass(frozen=True)
class MadeImage:
    """An image under each of its names; `settings` are those of its containers (Env, Entrypoint and so on)."""

    names: tuple[str, ...]
    layers: tuple[MadeLayer, ...]
    settings: Mapping[str, Any]

    def configuration(self) -> bytes:
        """The file that its digest is of."""
        described = {
            "architecture": "amd64",
            "os": "linux",
            "config": dict(self.settings),
            "rootfs": {
                "type": "layers",
                "diff_ids": [f"sha256:{layer.digest}" for layer in self.layers],
            },
        }
        return json.dumps(described, sort_keys=True).encode()


def layer(folder: Path, file: Path) -> MadeLayer:
    """A small layer of what is in a folder, compressed: the same for the same content."""
    return stored(["tar", "-C", str(folder), *SAME, "-c", "."], file, compressed=True)


def whole_layer(root: Path, file: Path) -> MadeLayer:
    """A layer of a whole system with owners, rights and attributes of its files; devices are the engine's."""
    words = [
        "--numeric-owner",
        "--xattrs",
        "--xattrs-include=*",
        "--exclude=./dev/*",
        "--sort=name",
        "-c",
        ".",
    ]
    return stored(["tar", "-C", str(root), *words], file, compressed=False)


def stored(command: Sequence[str], file: Path, compressed: bool) -> MadeLayer:
    """What a command writes as a layer; SetUpError has its words when it fails."""
    with (
        file.open("wb") as out,
        tempfile.TemporaryFile() as words,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=words) as made,
    ):
        assert made.stdout is not None
        target: IO[bytes] | gzip.GzipFile = gzip.GzipFile("", "wb", FASTEST, out, mtime=0) if compressed else out
        digest = hashlib.sha256()
        while block := made.stdout.read(BLOCK_BYTES):
            digest.update(block)
            target.write(block)
        if compressed:
            target.close()
        if made.wait(ENDED_SECONDS_MAX):
            words.seek(0)
            said = words.read().decode(errors="replace").strip()
            raise SetUpError(f"{' '.join(command[:3])}: {said[-1000:]}")
    return MadeLayer(file, digest.hexdigest())


def write(target: Path, images: Sequence[MadeImage]) -> None:
    """Write an archive of images; a layer that several have is written once."""
    layers = {made.digest: made.file for image in images for made in image.layers}
    configurations = {image.names: image.configuration() for image in images}
    described = [
        {
            "Config": f"{hashlib.sha256(configurations[image.names]).hexdigest()}.json",
            "RepoTags": list(image.names),
            "Layers": [f"{made.digest}.tar" for made in image.layers],
        }
        for image in images
    ]
    with tarfile.open(target, "w") as archive:
        for digest, file in layers.items():
            archive.add(file, f"{digest}.tar")
        for entry, image in zip(described, images, strict=True):
            _add(archive, str(entry["Config"]), configurations[image.names])
        _add(archive, "manifest.json", json.dumps(described).encode())


def _add(archive: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(content)
    archive.addfile(member, io.BytesIO(content))
