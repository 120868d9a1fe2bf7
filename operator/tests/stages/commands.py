"""The commands of charts and images (`[project.scripts]` of operator/pyproject.toml), run from this checkout."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from functools import cache

from tests.stages.paths import REPOSITORY

PROJECT_FILE = REPOSITORY / "operator" / "pyproject.toml"


@cache
def scripts() -> dict[str, str]:
    """Command -> `module:function`."""
    names: dict[str, str] = tomllib.loads(PROJECT_FILE.read_text(encoding="utf-8"))["project"]["scripts"]
    return names


def local_command(command: Sequence[str]) -> list[str]:
    """`command` of a container as it runs on this machine: `python3` is this Python, a command of ours its function."""
    if command[0] not in scripts():
        return [sys.executable, *command[1:]] if command[0] == "python3" else list(command)
    module, _, function = scripts()[command[0]].partition(":")
    return [sys.executable, "-c", f"from {module} import {function}; {function}()", *command[1:]]
