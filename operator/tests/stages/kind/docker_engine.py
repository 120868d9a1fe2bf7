"""A Docker engine of Debian's package for the time of a test, as kind's users have one: fetched and not installed, in
namespaces of its own (network, mounts, processes), so that it meets nothing of the machine and ends whole. Needs root.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from ci import packages
from ci.errors import SetUpError
from ci.folders import PROJECT, user_cache
from tests.stages.kind import cut_runtime

INSTALLED = "engine"
FETCHED = ("docker.io", "containerd")
NAMESPACES = ("--net", "--mount", "--propagation", "private", "--pid", "--fork", "--kill-child", "--mount-proc")
CONTROL_GROUPS = Path("/sys/fs/cgroup")
MODULES = Path("/lib/modules")  # kind mounts it into nodes, whether or not there are any
START_SECONDS_MAX, END_SECONDS_MAX = 60, 30
POLL_SECONDS = 0.2
WORDS_MAX = 3000
OWN = ("kind-cluster", "existing")  # folders of clusters below the user's cache: those of the machine's user stay


@dataclass(frozen=True)
class DockerEngine:
    """One that runs; all its files are in `folder`. `first` is the machine's number of its first process."""

    folder: Path
    first: int
    programs: tuple[Path, ...]

    @property
    def log(self) -> Path:
        """What the engine says."""
        return self.folder / "log"

    def environment(self) -> dict[str, str]:
        """Of a command that uses the engine: with the user's cache but for clusters."""
        path = os.pathsep.join([*map(str, self.programs), os.environ["PATH"]])
        own = {
            "PATH": path,
            "DOCKER_HOST": f"unix://{self.folder}/docker.sock",
            "DOCKER_CONFIG": str(self.folder),
            "KIND_EXPERIMENTAL_PROVIDER": "docker",
            "XDG_CACHE_HOME": str(self.folder / "cache"),
        }
        left_out = ("KUBECONFIG", "KIND_NODE_IMAGE")
        return {name: value for name, value in os.environ.items() if name not in left_out} | own

    def run(self, *command: str, seconds: float, text: str | None = None, **more: str) -> str:
        """What a command in the namespaces prints; AssertionError with the end of its words when it fails."""
        done = self.attempt(*command, seconds=seconds, text=text, **more)
        said = done.stdout[-WORDS_MAX:] + done.stderr[-WORDS_MAX:]
        assert done.returncode == 0, f"{' '.join(command)}: ended with {done.returncode}\n{said}"
        return done.stdout

    def attempt(
        self, *command: str, seconds: float, text: str | None = None, **more: str
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in the namespaces, in the project's folder; it is ended after its time."""
        entered = ["nsenter", "--target", str(self.first), "--net", "--mount", "--pid", f"--wd={PROJECT}", "timeout"]
        return subprocess.run(
            [*entered, "--kill-after=10", str(seconds), *command],
            input=text,
            env=self.environment() | more,
            capture_output=True,
            text=True,
            timeout=seconds + END_SECONDS_MAX,
            check=False,
        )

    def processes(self) -> set[int]:
        """Those of its namespaces and of its containers, by the machine's numbers."""
        lists = (file for top in control_groups(self.folder.name) for file in top.rglob("cgroup.procs"))
        contained = {int(number) for file in lists for number in file.read_text(encoding="ascii").split()}
        wanted = _namespace(self.first)
        return contained | {number for number in _all_processes() if wanted and _namespace(number) == wanted}


@contextmanager
def docker_engine(runc: Path) -> Iterator[DockerEngine]:
    """A Docker engine, with nothing of it left afterwards. SetUpError says what the machine lacks."""
    if os.geteuid() != 0:
        raise SetUpError("a Docker engine in namespaces of its own needs root; run the tests as root")
    packages.ensure(INSTALLED)
    unpacked = tuple(folder for name in FETCHED for folder in packages.unpacked(name))
    modules = MODULES.exists()
    folder = Path(tempfile.mkdtemp(prefix="robotkube-kind-"))
    try:
        _write_settings(folder, runc)
        _borrow_cache(folder / "cache" / "robotkube")
        with _running(folder, (folder / "bin", *unpacked)) as engine:
            yield engine
    finally:
        _remove_control_groups(folder.name)
        shutil.rmtree(folder)
        if not modules:
            with suppress(FileNotFoundError):
                MODULES.rmdir()


@contextmanager
def _running(folder: Path, programs: tuple[Path, ...]) -> Iterator[DockerEngine]:
    path = {"PATH": os.pathsep.join([*map(str, programs), os.environ["PATH"]])}
    dockerd = ["dockerd", "--config-file", str(folder / "daemon.json")]
    command = ["unshare", *NAMESPACES, sys.executable, "-m", "tests.stages.kind.first_process", *dockerd]
    with (folder / "log").open("w", encoding="utf-8") as log:
        started = subprocess.Popen(
            command, cwd=PROJECT / "operator", env=os.environ | path, stdout=log, stderr=log, stdin=subprocess.DEVNULL
        )
    there: set[int] = set()
    try:
        engine = DockerEngine(folder, _first(started), programs)
        try:
            _wait(engine, started)
            yield engine
        finally:
            there = engine.processes()
    finally:
        started.kill()  # its child, the first process there, is killed with it, and so all others
        started.wait(END_SECONDS_MAX)
        _wait_for_end(there)


def _first(started: subprocess.Popen[bytes]) -> int:
    """The child of unshare."""
    children = Path(f"/proc/{started.pid}/task/{started.pid}/children")
    end = time.monotonic() + START_SECONDS_MAX
    while time.monotonic() < end and started.poll() is None:
        if numbers := children.read_text(encoding="ascii").split():
            return int(numbers[0])
        time.sleep(POLL_SECONDS)
    raise SetUpError(f"no namespaces for a Docker engine can be made here: unshare {' '.join(NAMESPACES)} ended")


def _wait(engine: DockerEngine, started: subprocess.Popen[bytes]) -> None:
    end = time.monotonic() + START_SECONDS_MAX
    while time.monotonic() < end and started.poll() is None:
        if engine.attempt("docker", "version", seconds=START_SECONDS_MAX).returncode == 0:
            return
        time.sleep(POLL_SECONDS)
    raise SetUpError(f"the Docker engine does not answer here; it said: {engine.log.read_text()[-WORDS_MAX:]}")


def _wait_for_end(numbers: set[int]) -> None:
    """Wait until what was killed has ended, which takes a while."""
    end = time.monotonic() + END_SECONDS_MAX
    while still := [number for number in numbers if Path(f"/proc/{number}").exists()]:
        assert time.monotonic() < end, f"processes of the Docker engine are still there: {still}"
        time.sleep(POLL_SECONDS)


def _write_settings(folder: Path, runc: Path) -> None:
    """Everything of the engine lies in its folder, and its control groups below one of their own."""
    place = folder / "bin"
    place.mkdir()
    runtime = place / "runc"
    runtime.write_text(f'#!/bin/sh\nexec {sys.executable} -I -S {cut_runtime.__file__} {runc} "$@"\n', encoding="utf-8")
    runtime.chmod(0o755)
    settings: Mapping[str, object] = {
        "data-root": str(folder / "data"),
        "exec-root": str(folder / "exec"),
        "pidfile": str(folder / "pid"),
        "hosts": [f"unix://{folder}/docker.sock"],
        "deprecated-key-path": str(folder / "key.json"),
        "bip": "10.74.0.1/24",
        "default-address-pools": [{"base": "10.75.0.0/16", "size": 24}],
        "runtimes": {"cut": {"path": str(runtime)}},
        "default-runtime": "cut",
        "exec-opts": ["native.cgroupdriver=cgroupfs"],
        "cgroup-parent": f"/{folder.name}",
        "oom-score-adjust": 0,
    }
    (folder / "daemon.json").write_text(json.dumps(settings), encoding="utf-8")


def _borrow_cache(folder: Path) -> None:
    """A cache folder with everything that the user's has, by links, but for clusters."""
    folder.mkdir(parents=True)
    for path in user_cache().iterdir():
        if path.name not in OWN:
            (folder / path.name).symlink_to(path)


def control_groups(name: str) -> list[Path]:
    """The folders of a control group at the top, of all controllers."""
    return [path for pattern in (f"*/{name}", name) for path in CONTROL_GROUPS.glob(pattern)]


def _remove_control_groups(name: str) -> None:
    """Empty ones stay when who made them is killed."""
    for top in control_groups(name):
        for folder, _, _ in sorted(os.walk(top), key=lambda one: -len(one[0])):
            Path(folder).rmdir()


def left_of(engine: DockerEngine) -> list[str]:
    """What is still there of an engine that has ended: processes, mounts, control groups and files."""
    name = engine.folder.name
    mounts = Path("/proc/self/mountinfo").read_text(encoding="utf-8").splitlines()
    commands = [number for number in _all_processes() if name in _command(number)]
    files = [str(engine.folder)] if engine.folder.exists() else []
    return [*(line for line in mounts if name in line), *map(str, (*control_groups(name), *commands)), *files]


def _all_processes() -> list[int]:
    return [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]


def _namespace(number: int) -> str:
    with suppress(OSError):
        return str(Path(f"/proc/{number}/ns/net").readlink())
    return ""


def _command(number: int) -> str:
    with suppress(OSError):
        return Path(f"/proc/{number}/cmdline").read_text(encoding="utf-8", errors="replace")
    return ""
