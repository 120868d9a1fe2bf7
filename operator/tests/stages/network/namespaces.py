"""Sockets in another network namespace: a thread enters it, opens them, and ends there; they stay."""

from __future__ import annotations

import ctypes
import errno
import selectors
import socket
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

CLONE_NEWNET = 0x40000000
LOOK_SECONDS = 0.2
REFUSED = (0, errno.ECONNREFUSED)  # somebody is there, and the packet came to him
T = TypeVar("T")
_libc = ctypes.CDLL(None, use_errno=True)


def inside(namespace: Path, made: Callable[[], T]) -> T:
    """What `made` returns, called in a network namespace: a socket that it makes stays there."""

    def entered() -> T:
        with namespace.open("rb") as place:
            if _libc.setns(place.fileno(), CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), f"{namespace} cannot be entered")
            return made()

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(entered).result()


def begun(address: str, port: int) -> socket.socket:
    """A TCP connection that has sent its first packet."""
    found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    found.setblocking(False)
    found.connect_ex((address, port))
    return found


def reached(
    namespace: Path, targets: Iterable[tuple[str, int]], wanted: set[tuple[str, int]], least: float, most: float
) -> set[tuple[str, int]]:
    """Those of the addresses and ports (TCP) that answer or refuse: at once, for `least` seconds, in which a first
    packet that got lost is sent again, and until all of `wanted` have, at most `most`."""
    sockets = inside(namespace, lambda: {begun(*target): target for target in targets})
    found: set[tuple[str, int]] = set()
    start = time.monotonic()
    with selectors.DefaultSelector() as selector:
        for one, target in sockets.items():
            selector.register(one, selectors.EVENT_WRITE, target)
        while time.monotonic() < start + (least if wanted <= found else most) and selector.get_map():
            for key, _ in selector.select(LOOK_SECONDS):
                selector.unregister(key.fileobj)
                if sockets_error(key.fileobj) in REFUSED:
                    found.add(key.data)
    for one in sockets:
        one.close()
    return found


def sockets_error(one: object) -> int:
    """What came of a connection; 0 when it stands."""
    assert isinstance(one, socket.socket)
    return one.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
