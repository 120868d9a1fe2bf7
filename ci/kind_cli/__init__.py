"""kind, the program that makes clusters of containers: taken from PATH, else built, and only for `CLUSTER=kind`."""

from __future__ import annotations

import shutil
from pathlib import Path

from ci.toolchain.kept import Kept
from ci.toolchain.programs import Program

FOLDER = Path(__file__).resolve().parent
MODULE = "sigs.k8s.io/kind"
PROGRAMS = (Program("kind", MODULE, MODULE, {"kind": ("version",)}, folder=FOLDER),)


def ensure() -> Path:
    """The program; raises SetUpError when it is not on PATH and cannot be built."""
    program = shutil.which("kind")
    return Path(program) if program else Kept("kind", FOLDER, MODULE, PROGRAMS).ensure() / "kind"
