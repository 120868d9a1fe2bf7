"""Sockets in another network namespace: a thread enters it, opens them, and ends there; they stay."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

CLONE_NEWNET = 0x40000000
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
