"""The network links of this process's namespace: the middleware asks for them once, when a node is made.

Fast DDS uses the interfaces that run (IFF_RUNNING) at that moment and no others: a node that is made before the link
has its carrier hears nobody but itself, for as long as its process lives. The kernel sets the flag a moment after the
carrier is there, on a loaded machine seconds after.
"""

from __future__ import annotations

import fcntl
import socket
import struct
import time
from collections.abc import Callable, Mapping

LINK_SECONDS_MAX = 10.0
POLL_SECONDS = 0.05
SIOCGIFFLAGS = 0x8913  # netdevice(7)
UP, LOOPBACK, RUNNING = 0x1, 0x8, 0x40
_REQUEST = struct.Struct("16sH14x")


def links() -> Mapping[str, int]:
    """The flags of every interface, by name."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        flags_of_each = {}
        for _, name in socket.if_nameindex():
            try:
                answer = fcntl.ioctl(asked, SIOCGIFFLAGS, _REQUEST.pack(name.encode(), 0))
            except OSError:
                continue  # gone meanwhile
            flags_of_each[name] = _REQUEST.unpack(answer)[1]
    return flags_of_each


def awaited(flags: Mapping[str, int]) -> list[str]:
    """The links that are switched on and do not run yet; none when another one runs, or there are none."""
    real = {name: flag for name, flag in flags.items() if not flag & LOOPBACK}
    if any(flag & RUNNING for flag in real.values()):
        return []
    return [name for name, flag in real.items() if flag & UP]


def wait_for_link(
    flags: Callable[[], Mapping[str, int]] = links,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> list[str]:
    """Wait until a link runs, at most LINK_SECONDS_MAX; the links that did not (none: one runs, or there is none)."""
    end = clock() + LINK_SECONDS_MAX
    while (names := awaited(flags())) and clock() < end:
        sleep(POLL_SECONDS)
    return names
