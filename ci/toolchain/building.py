"""Building the programs into the cache, all or nothing.

    <cache>/toolchain/<key>/bin   every program; the folder appears when all of them had passed their smoke tests

The key is a hash of what is compiled from here (go.mod, go.sum, sources, patches), of how (programs.py), and of Go.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ci import packages
from ci.errors import SetUpError
from ci.folders import user_cache
from ci.steps import Steps
from ci.toolchain import go
from ci.toolchain.programs import FOLDER, GITEA, MODULES, PROGRAMS, Program

SMOKE_TIMEOUT_SECONDS = 30
KEPT_TOOLCHAINS = 2
MIB = 2**20
INPUTS = ("go.mod", "go.sum", "**/*.go", "gitea/go.mod", "gitea/go.sum", "programs.py", "ferretdb/**/*")


@dataclass(frozen=True)
class Toolchain:
    """The programs of the tool chain that were built from what `key` stands for."""

    key: str

    @property
    def folder(self) -> Path:
        """The folder of this key."""
        return user_cache() / "toolchain" / self.key

    @property
    def binaries(self) -> Path:
        """The folder of the programs."""
        return self.folder / "bin"


def inputs() -> tuple[Path, ...]:
    """The files the key is made of, sorted."""
    files = {path for pattern in INPUTS for path in FOLDER.glob(pattern) if path.is_file()}
    return tuple(sorted(path for path in files if "__pycache__" not in path.parts))


def key() -> str:
    """The key of what would be built now."""
    digest = hashlib.sha256(go.version().encode())
    for path in inputs():
        digest.update(f"\n{path.relative_to(FOLDER)}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def ensure() -> Toolchain:
    """The tool chain, built if the cache lacks it; raises SetUpError naming the program that failed."""
    install_packages()
    wanted = Toolchain(key())
    if wanted.binaries.is_dir():
        os.utime(wanted.folder)
        return wanted
    partial = wanted.folder.with_name(f"{wanted.key}.{os.getpid()}.partial")
    (partial / "bin").mkdir(parents=True)
    try:
        _build_all(partial / "bin")
        partial.rename(wanted.folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    _prune(wanted.folder.parent)
    shutil.rmtree(go.build_cache(), ignore_errors=True)
    return wanted


def install_packages() -> None:
    """Debian packages that the build needs, Go itself only if the machine has none."""
    packages.ensure("toolchain")
    go.ensure()


def _build_all(target: Path) -> None:
    versions = {module: go.module_version(FOLDER, module) for module in MODULES}
    versions[GITEA] = go.module_version(FOLDER / "gitea", GITEA)
    database = (FOLDER / "ferretdb" / "build.py").exists()
    steps = Steps(len(PROGRAMS) + database)
    sizes: dict[str, float] = {}
    for program in PROGRAMS:
        with steps.step(f"build {program.name}") as step:
            build(program, versions, target)
            smoke_test(program, versions[program.module], target)
            sizes[program.name] = (target / program.name).stat().st_size / MIB
            step.note = f"{versions[program.module]}, {sizes[program.name]:.0f} MiB"
    if database:
        with steps.step("build ferretdb") as step:
            _build_database(target)
            sizes["ferretdb"] = (target / "ferretdb").stat().st_size / MIB
            step.note = f"{sizes['ferretdb']:.0f} MiB"
    total = f"{len(sizes)} programs, {sum(sizes.values()):.0f} MiB, {sum(steps.seconds.values()):.0f} s"
    print(f"tool chain built: {total}", file=sys.stderr, flush=True)


def _build_database(target: Path) -> None:
    """FerretDB has a build of its own, which ends with its own smoke test."""
    with of_database() as module:
        module.build(target)


@contextmanager
def of_database(more: Mapping[str, str] = go.HERE) -> Iterator[Any]:
    """The module that builds FerretDB, while this process's environment has Go and `more`; SetUpError with what it says
    that fails."""
    module = importlib.import_module("ci.toolchain.ferretdb.build")
    command, environment = go.program()
    before = dict(os.environ)
    os.environ.update({**environment, "PATH": f"{Path(command).parent}:{environment['PATH']}", **more})
    try:
        yield module
    except RuntimeError as error:
        raise SetUpError(f"ferretdb: {error}") from error
    finally:
        os.environ.clear()
        os.environ.update(before)


def build(program: Program, versions: Mapping[str, str], target: Path, more: Mapping[str, str] = go.HERE) -> None:
    """Compile and link one program into `target`, reproducibly, resolving nothing; `more`: variables of Go."""
    stamps = [f"-X {name}={value}" for name, value in program.stamps(versions).items()]
    arguments = ["build", "-mod=readonly", "-trimpath", "-buildvcs=false"]
    arguments += ["-tags", program.tags, "-ldflags", " ".join(["-s -w", *stamps])]
    arguments += ["-o", str(target / program.name), program.package]
    go.run(arguments, program.folder, program.cgo, more)
    for link in program.links:
        (target / link).symlink_to(program.name)


def smoke_test(program: Program, version: str, target: Path) -> None:
    """Every name of the program answers, with its version; raises SetUpError with what it said."""
    for name, arguments in program.smoke.items():
        answer = subprocess.run(
            [target / name, *arguments],
            capture_output=True,
            text=True,
            timeout=SMOKE_TIMEOUT_SECONDS,
            check=False,
            env={"PATH": os.environ["PATH"], "HOME": str(target.parent)},
        )
        said = answer.stdout + answer.stderr
        if answer.returncode != 0 or version.removeprefix("v") not in said:
            raise SetUpError(f"{name} was built but does not run as {version}: exit {answer.returncode}, {said[-300:]}")


def _prune(base: Path) -> None:
    """Remove old tool chains (about 700 MB each) and partial ones that a kill left an hour ago or earlier."""
    whole = [path for path in base.iterdir() if path.suffix != ".partial"]
    whole.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    stale = [path for path in base.glob("*.partial") if path.stat().st_mtime < time.time() - 3600]
    for path in [*whole[KEPT_TOOLCHAINS:], *stale]:
        shutil.rmtree(path, ignore_errors=True)
