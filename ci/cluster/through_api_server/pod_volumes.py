"""Files in volume claims that no folder of this machine is behind: a pod mounts each claim, and small programs in it
read and write. The pods are restricted ones, end by themselves, and go with the block."""

from __future__ import annotations

import json
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from ci.errors import SetUpError
from robotkube.foundation.kubernetes.core.node_agents import selector

LABEL, OF_VOLUMES = "robotkube.io/added", "volumes"
FOLDER = "/volume"
LIFE_SECONDS = 7200
READY_SECONDS_MAX = 180
ANSWER_SECONDS_MAX = 60
COPY_SECONDS_MAX = 900
OWNER = 10001  # the user of the platform's pods
VolumeClaim = tuple[str, str]

WAITING = f"import time\ntime.sleep({LIFE_SECONDS})"
# What is below a folder: names, sizes, seconds of the last change. Copies keep these, so they tell.
LISTING = """
import json, os, sys
top = sys.argv[1]
names = sorted(os.listdir(top)) if os.path.isdir(top) else None
files = names and {n: [(s := os.stat(os.path.join(top, n))).st_size, int(s.st_mtime)] for n in names}
print(json.dumps(files))
"""
# A folder from a tar archive: whole, or not there.
UNPACKING = """
import os, shutil, sys, tarfile
target = sys.argv[1]
partial = os.path.join(os.path.dirname(target), "." + os.path.basename(target) + ".partial")
shutil.rmtree(partial, ignore_errors=True)
with tarfile.open(fileobj=sys.stdin.buffer, mode="r|") as archive:
    archive.extractall(partial)
if os.path.exists(target):
    shutil.rmtree(target)
os.rename(partial, target)
"""
MAKING = "import os, sys\nos.makedirs(sys.argv[1], exist_ok=True)"
READING = "import shutil, sys\nshutil.copyfileobj(open(sys.argv[1], 'rb'), sys.stdout.buffer)"
ENDING = """
import os, sys
path, length = sys.argv[1], int(sys.argv[2])
if os.path.isfile(path):
    with open(path, "rb") as stream:
        stream.seek(max(0, os.path.getsize(path) - length))
        sys.stdout.buffer.write(stream.read())
"""


@dataclass
class PodVolumes:
    """See provider.Volumes. `kubectl` is the command with what names the cluster, `image` one with Python, which the
    cluster pulls by the Secrets `pull_secrets`; copies of files are put below `work`. `guests`: the numbers of agents
    that are guests on their Node."""

    kubectl: Sequence[str]
    image: str
    work: Path
    pull_secrets: Sequence[Mapping[str, str]] = ()
    guests: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._used: set[VolumeClaim] = set()

    def use(self, volume_claims: Sequence[VolumeClaim]) -> None:
        """See Volumes.use: one pod each, on a Node of the agent whose namespace it is. The first pod of a claim is what
        gives it a volume, where that waits for one."""
        new = [volume_claim for volume_claim in volume_claims if volume_claim not in self._used]
        if not new:
            return
        if not self._used:
            self._remove()  # those of a run that was killed
        pods = {"apiVersion": "v1", "kind": "List", "items": [self._pod(volume_claim) for volume_claim in new]}
        with tempfile.TemporaryFile() as file:
            file.write(json.dumps(pods).encode())
            file.seek(0)
            _done([*self.kubectl, "apply", "-f", "-"], "pods of volume claims", ANSWER_SECONDS_MAX, file)
        self._used.update(new)
        for namespace, name in new:
            self._wait_ready(namespace, pod_name(name))

    def place(self, volume_claim: VolumeClaim, folder: Path) -> bool:
        """See Volumes.place."""
        target = f"{FOLDER}/{folder.name}"
        there = json.loads(self._inside(volume_claim, LISTING, target))
        here = {file.name: [file.stat().st_size, int(file.stat().st_mtime)] for file in folder.iterdir()}
        if there == here:
            return False
        archive = self._copies / f"{folder.name}.tar"
        archive.parent.mkdir(parents=True, exist_ok=True)
        try:
            _pack(folder, archive)
            with archive.open("rb") as file:
                self._inside(volume_claim, UNPACKING, target, source=file)
        finally:
            archive.unlink(missing_ok=True)
        return there is not None

    def make(self, volume_claim: VolumeClaim, folder: str) -> None:
        """See Volumes.make."""
        self._inside(volume_claim, MAKING, f"{FOLDER}/{folder}")

    def fetch(self, volume_claim: VolumeClaim, path: str) -> Path:
        """See Volumes.fetch: a copy."""
        copy = self._copies.joinpath(*volume_claim, path)
        copy.parent.mkdir(parents=True, exist_ok=True)
        with copy.open("wb") as file:
            self._inside(volume_claim, READING, f"{FOLDER}/{path}", copy=file)
        return copy

    def end_of(self, volume_claim: VolumeClaim, path: str, length: int) -> bytes:
        """See Volumes.end_of."""
        return self._inside(volume_claim, ENDING, f"{FOLDER}/{path}", str(length))

    def end(self) -> None:
        """Take the pods and the copies away."""
        if self._used:
            self._remove()
            self._used.clear()
        shutil.rmtree(self._copies, ignore_errors=True)

    def _remove(self) -> None:
        self._run("delete", "pods", "-A", "-l", f"{LABEL}={OF_VOLUMES}", "--ignore-not-found")

    @property
    def _copies(self) -> Path:
        return self.work / "volumes"

    def _inside(
        self,
        volume_claim: VolumeClaim,
        program: str,
        *arguments: str,
        source: IO[bytes] | None = None,
        copy: IO[bytes] | None = None,
    ) -> bytes:
        """What a program prints in the pod of a claim, into `copy` where there is one; it reads `source`."""
        namespace, name = volume_claim
        command = ["exec", *(["-i"] if source else []), "-n", namespace, pod_name(name), "--", "python3", "-c", program]
        what = f"volume claim {namespace}/{name}, {arguments[0]}"
        return _done([*self.kubectl, *command, *arguments], what, COPY_SECONDS_MAX, source, copy)

    def _run(self, *words: str) -> bytes:
        return _done([*self.kubectl, *words], f"kubectl {' '.join(words[:2])}", ANSWER_SECONDS_MAX)

    def _wait_ready(self, namespace: str, pod: str) -> None:
        wait = ["wait", "-n", namespace, "--for=condition=Ready", f"pod/{pod}", f"--timeout={READY_SECONDS_MAX}s"]
        try:
            _done([*self.kubectl, *wait], f"pod {namespace}/{pod}", READY_SECONDS_MAX + ANSWER_SECONDS_MAX)
        except SetUpError as error:
            about = f"--field-selector=involvedObject.name={pod}"
            events = self._run("get", "events", "-n", namespace, about).decode(errors="replace")
            raise SetUpError(f"{error}\n{events}") from error

    def _pod(self, volume_claim: VolumeClaim) -> dict[str, Any]:
        namespace, name = volume_claim
        alone = {"allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}}
        container = {
            "name": OF_VOLUMES,
            "image": self.image,
            "command": ["python3", "-c", WAITING],
            "securityContext": alone,
            "resources": {"requests": {"cpu": "10m", "memory": "32Mi"}, "limits": {"memory": "256Mi"}},
            "volumeMounts": [{"name": "volume", "mountPath": FOLDER}],
        }
        user = {"runAsNonRoot": True, "runAsUser": OWNER, "runAsGroup": OWNER, "fsGroup": OWNER}
        spec = {
            "restartPolicy": "Never",
            "activeDeadlineSeconds": LIFE_SECONDS,
            "terminationGracePeriodSeconds": 0,
            "automountServiceAccountToken": False,
            "enableServiceLinks": False,
            "nodeSelector": selector(namespace, self.guests.get(namespace, 0)),
            "imagePullSecrets": list(self.pull_secrets),
            "securityContext": {
                **user,
                "fsGroupChangePolicy": "OnRootMismatch",
                "seccompProfile": {"type": "RuntimeDefault"},
            },
            "containers": [container],
            "volumes": [{"name": "volume", "persistentVolumeClaim": {"claimName": name}}],
        }
        metadata = {"name": pod_name(name), "namespace": namespace, "labels": {LABEL: OF_VOLUMES}}
        return {"apiVersion": "v1", "kind": "Pod", "metadata": metadata, "spec": spec}


def pod_name(volume_claim: str) -> str:
    """The name of the pod that mounts a claim."""
    return f"robotkube-volume-{volume_claim}"


def _pack(folder: Path, archive: Path) -> None:
    """Write the files of a folder into a tar archive."""
    with tarfile.open(archive, "w") as packed:
        for file in sorted(folder.iterdir()):
            packed.add(file, file.name)


def _done(
    command: Sequence[str],
    what: str,
    seconds: float,
    source: IO[bytes] | None = None,
    copy: IO[bytes] | None = None,
) -> bytes:
    """What a command prints, into `copy` where there is one; it reads `source`. SetUpError with what it says when it
    fails."""
    given, taken = source or subprocess.DEVNULL, copy or subprocess.PIPE
    try:
        done = subprocess.run(command, stdin=given, stdout=taken, stderr=subprocess.PIPE, timeout=seconds, check=False)
    except subprocess.TimeoutExpired as error:
        raise SetUpError(f"{what}: no answer within {seconds:.0f} s") from error
    if done.returncode:
        raise SetUpError(f"{what}: {_last(done.stderr)}")
    return done.stdout or b""


def _last(said: bytes) -> str:
    return said.decode(errors="replace").strip()[-1500:]
