"""A name that this process alone resolves, for servers whose certificate has their name and not their address."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def resolved(name: str, address: str) -> Iterator[None]:
    """Connections to `name` go to `address` meanwhile."""
    lookup = socket.getaddrinfo

    def look_up(host: Any, *more: Any, **options: Any) -> Any:
        return lookup(address if host in (name, name.encode()) else host, *more, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket, "getaddrinfo", look_up)
        yield
