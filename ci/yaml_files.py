"""YAML files that people write for commands here, read with errors that name the file and the fix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from ci.errors import InputError


def read(path: Path, fix: str = "") -> Any:
    """What a file says; InputError when it cannot be read, then with the `fix`, or is not YAML."""
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}){f'; {fix}' if fix else ''}") from error
    except yaml.YAMLError as error:
        raise InputError(f"{path}: is not YAML: {' '.join(str(error).split())}") from error
