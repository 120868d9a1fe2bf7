"""Files in volume claims whose volumes are folders of this machine: placed by hard links, read where they are."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ci.cluster.api_server.client import Api
from ci.cluster.embedded import first_objects
from ci.errors import SetUpError

AGENT = "robotkube.io/agent"  # label of volumes
OWNER = 10001  # the user of the platform's pods
BIND_SECONDS_MAX = 30.0
POLL_SECONDS = 0.5
VolumeClaim = tuple[str, str]


class DiskVolumes:
    """See provider.Volumes."""

    def __init__(self, api: Api) -> None:
        self._api = api
        self._folders: dict[VolumeClaim, Path] = {}

    def use(self, volume_claims: Sequence[VolumeClaim]) -> None:
        """See Volumes.use: claims that no pod has used yet get a free volume of their agent's node, whose name is that
        of the namespace."""
        for volume_claim in volume_claims:
            self._bind(volume_claim)
        for volume_claim in volume_claims:
            self._wait_bound(volume_claim)

    def place(self, volume_claim: VolumeClaim, folder: Path) -> bool:
        """See Volumes.place: by hard links, or copies over file systems."""
        return place(folder, self._volume(volume_claim) / folder.name)

    def make(self, volume_claim: VolumeClaim, folder: str) -> None:
        """See Volumes.make."""
        made = self._volume(volume_claim) / folder
        made.mkdir(exist_ok=True)
        os.chown(made, OWNER, OWNER)

    def fetch(self, volume_claim: VolumeClaim, path: str) -> Path:
        """See Volumes.fetch: the file itself."""
        return self._volume(volume_claim) / path

    def end_of(self, volume_claim: VolumeClaim, path: str, length: int) -> bytes:
        """See Volumes.end_of."""
        return end_of(self._volume(volume_claim) / path, length)

    def _volume(self, volume_claim: VolumeClaim) -> Path:
        if volume_claim not in self._folders:
            self._folders[volume_claim] = first_objects.volume_path(self._api, *volume_claim)
        return self._folders[volume_claim]

    def _bind(self, volume_claim: VolumeClaim) -> None:
        namespace, name = volume_claim
        if self._read(volume_claim)["spec"].get("volumeName"):
            return
        volumes = self._api.get(f"{first_objects.VOLUMES}?labelSelector={AGENT}%3D{namespace}")["items"]
        free = [volume for volume in volumes if not volume["spec"].get("claimRef")]
        if not free:
            states = (f"{one['metadata']['name']} {one.get('status', {}).get('phase')}" for one in volumes)
            raise SetUpError(
                f"volume claim {namespace}/{name}: no volume of agent {namespace} is free (there are: "
                f"{', '.join(states) or 'none'})"
            )
        reference = {"namespace": namespace, "name": name, "apiVersion": "v1", "kind": "PersistentVolumeClaim"}
        self._api.merge(f"{first_objects.VOLUMES}/{free[0]['metadata']['name']}", {"spec": {"claimRef": reference}})

    def _wait_bound(self, volume_claim: VolumeClaim) -> None:
        end = time.monotonic() + BIND_SECONDS_MAX
        while self._read(volume_claim).get("status", {}).get("phase") != "Bound":
            if time.monotonic() > end:
                raise SetUpError(
                    f"volume claim {'/'.join(volume_claim)}: no volume was bound to it within {BIND_SECONDS_MAX:.0f} s"
                )
            time.sleep(POLL_SECONDS)

    def _read(self, volume_claim: VolumeClaim) -> dict[str, Any]:
        namespace, name = volume_claim
        return self._api.get(f"/api/v1/namespaces/{namespace}/persistentvolumeclaims/{name}")


def place(folder: Path, target: Path) -> bool:
    """Put a folder at `target` by hard links, or copies over file systems; True when another one had been there."""
    if target.is_dir() and _same(folder, target):
        return False
    partial = target.with_name(f".{target.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    shutil.copytree(folder, partial, copy_function=_link)
    replaced = target.exists()
    if replaced:
        shutil.rmtree(target)
    partial.rename(target)
    return replaced


def end_of(file: Path, length: int) -> bytes:
    """The last bytes of a file, so many at most; none when there is no such file."""
    try:
        with file.open("rb") as stream:
            stream.seek(max(0, file.stat().st_size - length))
            return stream.read()
    except OSError:
        return b""


def _same(folder: Path, target: Path) -> bool:
    names = {file.name for file in folder.iterdir()}
    return names == {file.name for file in target.iterdir()} and all(
        (folder / name).samefile(target / name) or _equal_copies(folder / name, target / name) for name in names
    )


def _equal_copies(first: Path, second: Path) -> bool:
    """Copies keep their time of change, so size and time tell."""
    one, other = first.stat(), second.stat()
    return (one.st_size, one.st_mtime_ns) == (other.st_size, other.st_mtime_ns)


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
