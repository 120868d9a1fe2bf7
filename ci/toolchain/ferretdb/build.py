"""Build FerretDB, the MongoDB-protocol server of the embedded profile, with accounts and roles.

Why it is built from a copy: the module archive has an empty version folder, so its command does not start, and its
accounts have no roles. What is changed is overlay/ (two files) and patches/ (seven small ones);
docs/decisions/0003-database-of-the-embedded-profile.md says why. Inputs are the files of this folder and the Go
tool chain: go.mod and go.sum here pin every dependency, MODULE_SUM the server itself.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

MODULE = "github.com/FerretDB/FerretDB"
VERSION = "v1.24.0"
MODULE_SUM = "h1:7WJmezL48Bj9bYWnhT/bEJgX5gjT5s7LFdHTqkN25rA="
TAGS = "ferretdb_no_postgresql"
DOWNLOAD_SECONDS_MAX = 600
BUILD_SECONDS_MAX = 1200

FOLDER = Path(__file__).resolve().parent


class BuildError(RuntimeError):
    """FerretDB cannot be built; the message names the step and the fix."""


def build(out: Path) -> None:
    """Write the static command `out`/ferretdb and run its smoke test; raise BuildError if a step fails."""
    out.mkdir(parents=True, exist_ok=True)
    program = out.resolve() / "ferretdb"
    with tempfile.TemporaryDirectory(prefix="ferretdb-") as folder:
        source = Path(folder) / "source"
        copy_module(source)
        change(source)
        compile_command(source, program)
    smoke_test(program)


def copy_module(target: Path) -> None:
    """Fetch the pinned module, compare its checksum with MODULE_SUM, copy it writable to `target`."""
    text = _run(["go", "mod", "download", "-json", f"{MODULE}@{VERSION}"], target.parent, DOWNLOAD_SECONDS_MAX)
    found = json.loads(text)
    if found["Sum"] != MODULE_SUM:
        raise BuildError(
            f"{MODULE}@{VERSION} has the checksum {found['Sum']}, expected {MODULE_SUM}: refusing to build"
        )
    shutil.copytree(found["Dir"], target, copy_function=shutil.copyfile)
    for path in [target, *target.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)


def change(source: Path) -> None:
    """Apply everything that differs from upstream: version, pinned dependencies, new files, patches in order."""
    (source / "build/version/version.txt").write_text(f"{VERSION}\n")
    (source / "build/version/package.txt").write_text("robotkube\n")
    for name in ("go.mod", "go.sum"):
        shutil.copyfile(FOLDER / name, source / name)
    shutil.copytree(FOLDER / "overlay", source, dirs_exist_ok=True)
    for patch in sorted((FOLDER / "patches").glob("*.patch")):
        _run(["git", "apply", "--whitespace=nowarn", str(patch)], source, 60)


def compile_command(source: Path, program: Path) -> None:
    """Compile the static command; nothing is resolved, so equal inputs give equal bytes."""
    flags = ["-mod=readonly", "-trimpath", "-buildvcs=false", "-ldflags", "-s -w", "-tags", TAGS]
    _run(["go", "build", *flags, "-o", str(program), "./cmd/ferretdb"], source, BUILD_SECONDS_MAX)


def smoke_test(program: Path) -> None:
    """Ask the program for its version; raise BuildError if it is not the expected one."""
    with tempfile.TemporaryDirectory(prefix="ferretdb-") as folder:
        said = _run([str(program), "--version"], Path(folder), 30)
    if f"version: {VERSION}" not in said:
        raise BuildError(f"{program} --version does not say {VERSION}: {said!r}")


def _run(command: list[str], folder: Path, seconds_max: float) -> str:
    # GIT_CEILING_DIRECTORIES: `git apply` must not find a repository above the temporary folder and skip the files
    environment = {**os.environ, "CGO_ENABLED": "0", "GOWORK": "off", "GIT_CEILING_DIRECTORIES": str(folder.parent)}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=seconds_max, check=False
    )
    if done.returncode != 0:
        raise BuildError(f"`{' '.join(command[:3])}` failed with code {done.returncode}: {done.stderr.strip()[-2000:]}")
    return done.stdout


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m ci.toolchain.ferretdb.build FOLDER")
    build(Path(sys.argv[1]))
