"""What other commands stand on: Debian packages and tool chain. Each step is cached, and done once per process."""

from __future__ import annotations

import functools
import os
from pathlib import Path

from ci import packages, toolchain
from ci.machine import preflight

TOOLCHAIN_VARIABLE = "ROBOTKUBE_TOOLCHAIN_BIN"


@functools.cache
def tool_chain() -> Path:
    """Folder of the programs, built when they are not in the cache."""
    preflight.require()
    packages.ensure("toolchain", "cluster", "images")
    return toolchain.ensure().binaries


@functools.cache
def for_tests() -> None:
    """Debian packages that tests and benchmarks run; a broker is put on this process's PATH."""
    packages.ensure("tests", "images")
    os.environ["PATH"] = os.pathsep.join([os.environ["PATH"], *map(str, packages.unpacked("mosquitto"))])
