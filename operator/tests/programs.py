"""Programs of the tool chain, as `make test` names their folder, else as they are built (or found built) here."""

from __future__ import annotations

import errno
import functools
import os
import random
import socket
from pathlib import Path

from ci import preparing, toolchain

PORTS = (12_000, 30_000)  # above the well-known ones, below node ports and the kernel's own choice
PORT_TRIALS_MAX = 100


@functools.cache
def folder() -> Path:
    """The folder of all programs."""
    given = os.environ.get(preparing.TOOLCHAIN_VARIABLE)
    return Path(given) if given else toolchain.ensure().binaries


def program(name: str) -> str:
    """Path of one program; a missing one fails the test that needs it."""
    path = folder() / name
    assert path.is_file(), f"{path} is missing: run make toolchain"
    return str(path)


def free_port() -> int:
    """A loopback TCP port nobody listens on at this moment.

    Drawn below those that the kernel gives to outgoing connections, so that nothing takes it before its server does,
    and at random, so that tests beside this one draw others.
    """
    for _ in range(PORT_TRIALS_MAX):
        port = random.SystemRandom().randrange(*PORTS)
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
                continue
        return port
    raise AssertionError(f"no free port among {PORT_TRIALS_MAX} of {PORTS}")
