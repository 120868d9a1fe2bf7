"""Build contexts: exactly the files an image is made of, and the key that stands for them.

A context mirrors the repository's paths, so that `docker build -f operator/images/<name>/Dockerfile .` at the top of a
checkout works for images that need nothing else. Programs are in `bin/`, data files of Go modules in
`share/<module>/`.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

IGNORED_NAMES = frozenset({"__pycache__", ".mypy_cache", ".ruff_cache", ".pytest_cache"})
IGNORED_SUFFIXES = (".pyc", ".egg-info")
READ_BYTES = 1 << 20


class ContextError(Exception):
    """A file that an image needs is not there; the message names the image, the file and what makes it."""


@dataclass(frozen=True)
class Copied:
    """One file or folder of a context: `source` on this machine, `target` inside the context. An absent optional
    folder is empty."""

    source: Path
    target: str
    executable: bool = False
    optional: bool = False


def files_of(copied: Copied) -> Iterator[tuple[Path, str, bool]]:
    """All files below `copied`: path here, path in the context, whether it is a program."""
    if copied.source.is_file():
        yield copied.source, copied.target, copied.executable
        return
    for folder, folders, names in os.walk(copied.source):
        folders[:] = sorted(name for name in folders if not _ignored(name))
        for name in sorted(names):
            path = Path(folder) / name
            if not _ignored(name) and path.is_file():
                relative = path.relative_to(copied.source)
                yield path, f"{copied.target}/{relative}", copied.executable or os.access(path, os.X_OK)


def _ignored(name: str) -> bool:
    return name in IGNORED_NAMES or name.endswith(IGNORED_SUFFIXES)


def check(image: str, contents: tuple[Copied, ...]) -> None:
    """Refuse a context whose sources are missing, before anything is built."""
    for copied in contents:
        if not copied.source.exists() and not copied.optional:
            raise ContextError(
                f"image {image}: {copied.source} is missing ({copied.target} of its build context); {_fix(copied)}"
            )


def _fix(copied: Copied) -> str:
    if copied.target.startswith("bin/"):
        return "build the tool chain first (python -m ci.toolchain) or name its folder with --toolchain-bin"
    return "restore it from the repository"


def key_of(contents: tuple[Copied, ...], *more: str) -> str:
    """16 hex digits that change when a path, a program bit or a byte of the context changes, or one of `more`."""
    total = hashlib.sha256()
    for text in more:
        total.update(f"{len(text)}:{text}\n".encode())
    for copied in contents:
        for path, target, executable in files_of(copied):
            total.update(f"{target}\0{executable}\0{_hash(path)}\n".encode())
    return total.hexdigest()[:16]


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def assemble(contents: tuple[Copied, ...], folder: Path) -> None:
    """Make the context in `folder` (made, must be empty); modes do not depend on the umask."""
    folder.mkdir(parents=True, exist_ok=True)
    for copied in contents:
        if copied.optional or copied.source.is_dir():
            (folder / copied.target).mkdir(parents=True, exist_ok=True)
        for path, target, executable in files_of(copied):
            place = folder / target
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, place)
            place.chmod(0o755 if executable else 0o644)
    for made, _, _ in os.walk(folder):
        Path(made).chmod(0o755)  # Dockerfiles copy folders with their modes
