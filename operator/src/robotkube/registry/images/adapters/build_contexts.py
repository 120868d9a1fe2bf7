"""Build contexts whose modes do not depend on who checked the sources out, and without what programs leave behind."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from robotkube.errors import InputError

FILES_MAX = 100_000
LEFT_OUT = frozenset({".git", "__pycache__", ".pytest_cache", ".mypy_cache", ".ruff_cache", ".venv"})
LEFT_OUT_SUFFIX = ".pyc"


def copy_context(source: Path, target: Path) -> None:
    """Copy files, folders and links of `source` to the new folder `target`; a program stays one, all else is readable
    and no more. InputError when there are more than FILES_MAX files."""
    count = 0
    for place, folders, names in os.walk(source):
        links = [name for name in folders if (Path(place) / name).is_symlink()]
        folders[:] = sorted(name for name in folders if name not in LEFT_OUT and name not in links)
        copy = target / Path(place).relative_to(source)
        copy.mkdir(parents=True)
        copy.chmod(0o755)
        for name in sorted([*names, *links]):
            if not name.endswith(LEFT_OUT_SUFFIX):
                _copy(Path(place) / name, copy / name)
                count += 1
        if count > FILES_MAX:
            raise InputError(f"{source}: more than {FILES_MAX} files; build in the folder of the Dockerfile alone")


def _copy(path: Path, copy: Path) -> None:
    if path.is_symlink():
        copy.symlink_to(path.readlink())
    elif path.is_file():
        shutil.copyfile(path, copy)
        copy.chmod(0o755 if os.access(path, os.X_OK) else 0o644)
