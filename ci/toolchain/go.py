"""Go itself: found, fetched in the version that go.mod asks for if need be, and run."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType

from ci import packages
from ci.errors import SetUpError
from ci.folders import user_cache

WANTED = (1, 26, 8)
WANTED_NAME = "go" + ".".join(map(str, WANTED))
SELF_RAISING = (1, 21)  # from here on Go fetches the version it is asked for (GOTOOLCHAIN)
PLACES = ("/usr/local/go/bin/go", "/usr/lib/go/bin/go")
FETCH_TIMEOUT_SECONDS = 600
COMMAND_TIMEOUT_SECONDS = 1800
HERE: Mapping[str, str] = MappingProxyType({})  # no variables that have Go compile for another machine


def find() -> Path | None:
    """The newest Go of this machine (PATH and the usual places); None when there is none."""
    candidates = [shutil.which("go"), *PLACES]
    versions = sorted((_version(path), path) for path in candidates if path and Path(path).exists())
    return Path(versions[-1][1]) if versions else None


def ensure() -> Path:
    """The newest Go of this machine; Debian's is installed when there is none (any version fetches the wanted one)."""
    if find() is None:
        packages.ensure("go")
    go = find()
    if go is None:
        raise SetUpError(f"Go is missing: install {WANTED_NAME} or newer, or golang-go on Debian.")
    return go


def build_cache() -> Path:
    """Compiled packages of a build under way: 6 GB that nobody needs once the programs are there."""
    return user_cache() / "go-build"


@cache
def program() -> tuple[str, dict[str, str]]:
    """The go command and the environment that make it at least WANTED; fetches that version if need be."""
    go = ensure()
    version = _version(str(go))
    environment = {name: value for name, value in os.environ.items() if name not in ("GOFLAGS", "GOROOT")}
    environment["GOCACHE"] = str(build_cache())
    if version >= WANTED:
        return str(go), environment | {"GOTOOLCHAIN": "local"}
    if version >= SELF_RAISING:
        return str(go), environment | {"GOTOOLCHAIN": WANTED_NAME}
    return str(_fetched(go, environment)), environment | {"GOTOOLCHAIN": "local"}


def _fetched(go: Path, environment: Mapping[str, str]) -> Path:
    """Let an old Go download the wanted one as a module, as a newer one would by itself."""
    module = f"golang.org/toolchain@v0.0.1-{WANTED_NAME}.linux-amd64"
    answer = subprocess.run(
        [go, "mod", "download", "-json", module],
        env=dict(environment),
        cwd="/",
        capture_output=True,
        text=True,
        timeout=FETCH_TIMEOUT_SECONDS,
        check=False,
    )
    if answer.returncode != 0:
        raise SetUpError(f"{WANTED_NAME} cannot be fetched by {go}: {(answer.stderr or answer.stdout).strip()[-300:]}")
    folder = Path(json.loads(answer.stdout)["Dir"])
    for place in (folder / "bin", folder / "pkg" / "tool"):  # module archives carry no permissions
        for file in place.rglob("*"):
            file.chmod(0o755)
    return folder / "bin" / "go"


def version() -> str:
    """What the go command says about itself, part of the tool chain's key."""
    return run(["version"], Path("/")).strip()


def run(arguments: Sequence[str], folder: Path, cgo: bool = False, more: Mapping[str, str] = HERE) -> str:
    """Run `go ARGUMENTS` in `folder`, with `more` variables; its standard output; raises SetUpError with the end of its
    messages."""
    go, environment = program()
    result = subprocess.run(
        [go, *arguments],
        cwd=folder,
        env={**environment, "CGO_ENABLED": "1" if cgo else "0", **more},
        capture_output=True,
        text=True,
        timeout=COMMAND_TIMEOUT_SECONDS,
        check=False,
    )
    if result.returncode != 0:
        raise SetUpError(f"go {' '.join(arguments[:2])} in {folder} failed:\n{result.stderr.strip()[-2000:]}")
    return result.stdout


def module_version(folder: Path, module: str) -> str:
    """Version of `module` in the go.mod of `folder`, with its v."""
    return run(["list", "-mod=readonly", "-m", "-f", "{{.Version}}", module], folder).strip()


def module_folder(folder: Path, module: str) -> Path:
    """The folder of the sources of `module`; downloads them if the module cache lacks them."""
    document = json.loads(run(["mod", "download", "-json", module], folder))
    return Path(document["Dir"])


def _version(path: str) -> tuple[int, ...]:
    answer = subprocess.run(
        [path, "version"],
        env=os.environ | {"GOTOOLCHAIN": "local"},
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    match = re.search(r"go version go(\d+)\.(\d+)(?:\.(\d+))?", answer.stdout)
    return tuple(int(part or 0) for part in match.groups()) if match else (0,)
