"""docker: the daemon builds, and what it saves is brought into the form in which other engines write an image."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import tarfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from robotkube.errors import InputError
from robotkube.registry.images.adapters.buildah import (
    BUILD_SECONDS_MAX,
    COMMAND_SECONDS_MAX,
    run_logged,
)
from robotkube.registry.images.adapters.normalising import BLOCK_BYTES, Hashing
from robotkube.registry.suites.adapters.image_layers import unpacked

ASKING_SECONDS_MAX = 60


@dataclass(frozen=True)
class Docker:
    """Port Engine. `log` collects the output of all commands."""

    log: Path
    program: str = "docker"

    def has(self, tag: str) -> bool:
        """Return whether the daemon has it."""
        command = [self.program, "image", "inspect", tag]
        return subprocess.run(command, capture_output=True, check=False, timeout=ASKING_SECONDS_MAX).returncode == 0

    def load(self, archive: Path, tag: str) -> None:
        """Give the daemon the archive, which names its image `tag` itself."""
        self._run("load", "--input", str(archive), seconds=COMMAND_SECONDS_MAX)

    def build(self, context: Path, dockerfile: Path, tag: str, arguments: Mapping[str, str]) -> None:
        """Build with the daemon's cache."""
        words = ["build", "--file", str(dockerfile), "--tag", tag]
        words += [f"--build-arg={name}={value}" for name, value in arguments.items()]
        self._run(*words, str(context), seconds=BUILD_SECONDS_MAX)

    def export(self, tag: str, folder: Path) -> None:
        """Save the image and take the archive apart."""
        archive = folder.with_suffix(".saved")
        self._run("save", "--output", str(archive), tag, seconds=COMMAND_SECONDS_MAX)
        folder.mkdir()
        take_apart(archive, folder)
        archive.unlink()

    def _run(self, *words: str, seconds: int) -> None:
        run_logged([self.program, *words], self.log, seconds, {})


def take_apart(archive: Path, folder: Path) -> None:
    """Write what `docker save` made of one image to `folder`: manifest.json, configuration and plain layers named by
    hex digest."""
    with tarfile.open(archive, "r:") as saved:
        described = _described(archive, saved)
        config = _blob(_content(archive, saved, described["Config"]), folder)
        layers = [_blob(_plain(_content(archive, saved, path)), folder) for path in described["Layers"]]
    (folder / "manifest.json").write_text(json.dumps({"config": config, "layers": layers}), encoding="utf-8")


def _described(archive: Path, saved: tarfile.TarFile) -> dict[str, Any]:
    document: list[dict[str, Any]] = json.load(_content(archive, saved, "manifest.json"))
    if len(document) != 1:
        raise InputError(f"{archive}: holds {len(document)} images, not one; build it for one platform")
    return document[0]


def _content(archive: Path, saved: tarfile.TarFile, path: str) -> IO[bytes]:
    try:
        content = saved.extractfile(path)
    except KeyError:
        content = None
    if content is None:
        raise InputError(f"{archive}: has no {path}; docker saved something else than an image")
    return content


def _plain(content: IO[bytes]) -> IO[bytes]:
    return unpacked(io.BufferedReader(content, BLOCK_BYTES))


def _blob(content: IO[bytes], folder: Path) -> dict[str, Any]:
    """Write it under its digest."""
    part = folder / "part"
    with part.open("wb") as out:
        hashing = Hashing(out)
        shutil.copyfileobj(content, hashing, BLOCK_BYTES)
    blob = hashing.blob()
    part.replace(folder / blob.digest.removeprefix("sha256:"))
    return {"digest": blob.digest, "size": blob.size}
