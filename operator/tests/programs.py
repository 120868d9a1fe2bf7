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

_given: set[int] = set()


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
    and at random, so that tests beside this one draw others. A server may listen much later, and now and then only: no
    port is given twice, and workers of one run draw from ports of their own.
    """
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    for _ in range(PORT_TRIALS_MAX):
        port = random.SystemRandom().randrange(PORTS[0] + worker, PORTS[1], workers)
        if port in _given:
            continue
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
                continue
        _given.add(port)
        return port
    raise AssertionError(f"no free port among {PORT_TRIALS_MAX} of {PORTS}")
