"""Builds every program of the embedded cluster from committed go.mod and go.sum, without resolving anything.

`ensure().binaries` is the folder of the programs. Files that a program needs beside its binary (templates of the forge,
manifests of Argo CD) are in its module's folder.
"""

from __future__ import annotations

from pathlib import Path

from ci.toolchain import go
from ci.toolchain.building import Toolchain, ensure, key
from ci.toolchain.programs import FOLDER, GITEA


def module_dir(module: str) -> Path:
    """The folder with the sources of a module that the tool chain pins, for example github.com/argoproj/argo-cd/v3."""
    return go.module_folder(FOLDER / "gitea" if module == GITEA else FOLDER, module)


def gitea_static(name: str) -> Path:
    """One of the folders `options`, `templates`, `public` that the forge reads at run time (STATIC_ROOT_PATH)."""
    if name not in ("options", "templates", "public"):
        raise ValueError(f"{name!r} is none of options, templates, public")
    return module_dir(GITEA) / name


__all__ = ["Toolchain", "ensure", "gitea_static", "key", "module_dir"]
