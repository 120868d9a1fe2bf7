"""What can be reached from another network namespace."""

from __future__ import annotations

import errno
import selectors
import socket
import time
from collections.abc import Iterable
from pathlib import Path

from ci.cluster.embedded.network.namespaces import inside

LOOK_SECONDS = 0.2
REFUSED = (0, errno.ECONNREFUSED)  # somebody is there, and the packet came to him


def begun(address: str, port: int) -> socket.socket:
    """A TCP connection that has sent its first packet."""
    connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    connection.setblocking(False)
    connection.connect_ex((address, port))
    return connection


def reached(
    namespace: Path, targets: Iterable[tuple[str, int]], wanted: set[tuple[str, int]], least: float, most: float
) -> set[tuple[str, int]]:
    """Those of the addresses and ports (TCP) that answer or refuse: at once, for `least` seconds, in which a first
    packet that got lost is sent again, and until all of `wanted` have, at most `most`."""
    sockets = inside(namespace, lambda: {begun(*target): target for target in targets})
    accepted: set[tuple[str, int]] = set()
    start = time.monotonic()
    with selectors.DefaultSelector() as selector:
        for one, target in sockets.items():
            selector.register(one, selectors.EVENT_WRITE, target)
        while time.monotonic() < start + (least if wanted <= accepted else most) and selector.get_map():
            for key, _ in selector.select(LOOK_SECONDS):
                selector.unregister(key.fileobj)
                if sockets_error(key.fileobj) in REFUSED:
                    accepted.add(key.data)
    for one in sockets:
        one.close()
    return accepted


def sockets_error(one: object) -> int:
    """What came of a connection; 0 when it stands."""
    assert isinstance(one, socket.socket)
    return one.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
