"""The forge's pages, from the sources in its Go module: `make web` builds them, once per digest of these sources.

    <cache>/web/<key>/assets    what the pages load: scripts, styles, fonts, and the list by which the forge finds them

The images of the forge that are built afterwards have them; nothing else builds them or needs them. pnpm, which the
module's lock file is for, is a package that package-lock.json pins; Node is the console's (ci/console.py).
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Set
from contextlib import contextmanager
from pathlib import Path

from ci import console
from ci.errors import SetUpError
from ci.folders import user_cache
from ci.toolchain import module_dir
from ci.toolchain.programs import FOLDER as TOOLCHAIN
from ci.toolchain.programs import GITEA

FOLDER = Path(__file__).resolve().parent
GO_SUM = TOOLCHAIN / "gitea" / "go.sum"
NPM_FILES = ("package.json", "package-lock.json", ".npmrc")
FORMAT = "1"  # part of every key: raise it when the same sources are built in another way
KEPT_BUILDS = 2
SECONDS_MAX = 900
STALE_SECONDS = 3600
# What the build reads of the module. The styles follow from the words in templates and programs.
FOLDERS = ("assets", "build", "models", "modules", "public", "routers", "services", "templates", "web_src")
FILES = ("package.json", "pnpm-lock.yaml", ".npmrc", "vite.config.ts", "tailwind.config.ts")
RESULT = Path("public") / "assets"
# By the first the forge finds the files, by the second everybody knows that they are there.
NEEDED = (".vite/manifest.json", "licenses.txt")


def key() -> str:
    """The key of what would be built now. The sources' digest is the one that Go holds the module to."""
    digest = hashlib.sha256(FORMAT.encode() + console.LOCK.read_bytes())
    for line in GO_SUM.read_text(encoding="utf-8").splitlines():
        if line.startswith(f"{GITEA} "):
            digest.update(f"{line}\n".encode())
    for name in NPM_FILES:
        digest.update((FOLDER / name).read_bytes())
    return digest.hexdigest()[:16]


def built() -> Path | None:
    """The folder of what the forge's pages load, if `make web` has built it for this version of the forge."""
    result = _cache() / key() / "assets"
    return result if result.is_dir() else None


def build() -> Path:
    """The folder of what the forge's pages load, built when the cache lacks it. SetUpError when it cannot be built."""
    result = _cache() / key() / "assets"
    if result.is_dir():
        os.utime(result.parent)
        return result
    print("building the forge's pages (once per version of the forge)", file=sys.stderr, flush=True)
    with _workshop() as workshop:
        pnpm = _pnpm(workshop / "pnpm")
        sources = workshop / "forge"
        _copy_sources(module_dir(GITEA), sources)
        own = {path.name for path in (sources / RESULT).iterdir()}
        store = f"--store-dir={workshop / 'store'}"
        _run(sources, str(pnpm), "install", "--frozen-lockfile", "--prod", "--ignore-scripts", store)
        _run(sources, str(sources / "node_modules" / "vite" / "bin" / "vite.js"), "build", "--logLevel", "warn")
        _keep(sources / RESULT, own, result)
    _forget_old()
    return result


def _keep(made: Path, own: Set[str], result: Path) -> None:
    """Move what the build made beside the module's `own` files to where it is kept, all or nothing."""
    missing = [name for name in NEEDED if not (made / name).exists()]
    if missing:
        raise SetUpError(f"the build of the forge's pages made no {', '.join(missing)} in {RESULT}")
    partial = made.parent / "partial"
    partial.mkdir()
    for path in list(made.iterdir()):
        if path.name not in own:
            path.rename(partial / path.name)
    result.parent.mkdir(parents=True, exist_ok=True)
    if not result.is_dir():
        partial.rename(result)


def _copy_sources(module: Path, target: Path) -> None:
    """What the build needs of the module, whose own folder cannot be written to."""
    absent = [name for name in (*FOLDERS, *FILES) if not (module / name).exists()]
    if absent:
        raise SetUpError(f"the forge's module has no {', '.join(absent)}, without which its pages cannot be built")
    target.mkdir()
    for name in FOLDERS:
        shutil.copytree(module / name, target / name, copy_function=shutil.copyfile)
    for name in FILES:
        shutil.copyfile(module / name, target / name)
    for folder, _, _ in os.walk(target):
        Path(folder).chmod(0o755)


def _pnpm(folder: Path) -> Path:
    """The script of pnpm, installed in `folder`."""
    folder.mkdir()
    for name in NPM_FILES:
        shutil.copyfile(FOLDER / name, folder / name)
    _, npm = console.node()
    _run(folder, npm, "ci", "--ignore-scripts", "--no-progress", "--loglevel=error")
    return folder / "node_modules" / "pnpm" / "bin" / "pnpm.cjs"


def _run(folder: Path, script: str, *arguments: str) -> None:
    """Run a script by Node; SetUpError with the end of what it said."""
    node, _ = console.node()
    path = os.pathsep.join([str(Path(node).parent), os.environ["PATH"]])
    variables = {**os.environ, "PATH": path, "CI": "true", "NO_COLOR": "1", "NODE_ENV": "production"}
    called = " ".join([Path(script).name, *arguments])
    try:
        done = subprocess.run(
            [node, script, *arguments], cwd=folder, env=variables, capture_output=True, text=True, timeout=SECONDS_MAX,
            check=False,
        )  # fmt: skip
    except (subprocess.TimeoutExpired, OSError) as error:
        raise SetUpError(f"the forge's pages: {called}: {error}") from error
    if done.returncode:
        raise SetUpError(f"the forge's pages: {called}:\n{(done.stdout + done.stderr).strip()[-2000:]}")


def _cache() -> Path:
    return user_cache() / "web"


@contextmanager
def _workshop() -> Iterator[Path]:
    """A folder to build in; gone afterwards."""
    _cache().mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=_cache(), prefix="work-") as made:
        yield Path(made)


def _forget_old() -> None:
    """Keep the newest builds, and no workshop that a kill left an hour ago or earlier."""
    builds = sorted((path.parent for path in _cache().glob("*/assets")), key=_age, reverse=True)
    stale = [path for path in _cache().glob("work-*") if _age(path) < time.time() - STALE_SECONDS]
    for path in [*builds[KEPT_BUILDS:], *stale]:
        shutil.rmtree(path, ignore_errors=True)


def _age(path: Path) -> float:
    return path.stat().st_mtime
