"""Python environments of single tools, below the user's cache folder: each from a lock of its own, installed once."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

from ci.errors import SetUpError
from ci.folders import user_cache

INSTALL_SECONDS_MAX = 600


def environment(name: str, lock: Path) -> Path:
    """The folder of the environment of `lock`, which is installed when it is not there; `name` is its place in the
    cache."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    key = hashlib.sha256(lock.read_bytes() + version.encode()).hexdigest()[:16]
    home = user_cache() / name / key
    if not (home / "complete").exists():
        print(f"installing {lock.name} into {home} (once)", file=sys.stderr, flush=True)
        shutil.rmtree(home, ignore_errors=True)
        _run(lock, sys.executable, "-m", "venv", str(home))
        pip = [str(home / "bin" / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        _run(lock, *pip, "--require-hashes", "--no-deps", "-r", str(lock))
        (home / "complete").touch()
    return home


def _run(lock: Path, *command: str) -> None:
    try:
        subprocess.run(command, check=True, timeout=INSTALL_SECONDS_MAX)
    except (subprocess.SubprocessError, OSError) as error:
        raise SetUpError(f"the packages of {lock.name} cannot be installed: {error}; run it again") from error
