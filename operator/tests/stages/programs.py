"""Programs of the tool chain, in the folder that `make test` names, else where `make toolchain` has built them."""

from __future__ import annotations

import functools
import os
from pathlib import Path

from benchmarks.measuring.pods import free_port as free_port
from ci import toolchain
from ci.machine import preparing

# Of Go: collecting costs a rendering of Helm a fifth, an API server that is told of kinds a third, and what tests start
# ends before it would be short of memory.
SELDOM_COLLECTING = {"GOGC": "off", "GOMEMLIMIT": "1GiB"}


@functools.cache
def folder() -> Path:
    """The folder of all programs."""
    given = os.environ.get(preparing.TOOLCHAIN_VARIABLE)
    return Path(given) if given else toolchain.Toolchain(toolchain.key()).binaries


def program(name: str) -> str:
    """Path of one program; a missing one fails the test that needs it."""
    path = folder() / name
    assert path.is_file(), f"{path} is missing: run make toolchain"
    return str(path)
