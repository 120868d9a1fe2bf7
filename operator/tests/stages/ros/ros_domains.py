"""ROS domains of this test process's own: nodes of other test processes beside it are never heard."""

import atexit
import functools
import os
import socket

DOMAINS = range(100, 200)


@functools.cache
def domain(name: str = "") -> str:
    """For ROS_DOMAIN_ID, one for each name; reserved on this machine until the process ends."""
    for offset in range(len(DOMAINS)):
        number = DOMAINS[(os.getpid() + offset) % len(DOMAINS)]
        reservation = socket.socket(socket.AF_UNIX)
        try:
            reservation.bind(f"\0robotkube-tests-ros-domain-{number}")
        except OSError:
            reservation.close()
            continue
        atexit.register(reservation.close)
        return str(number)
    raise AssertionError(f"all ROS domains of {DOMAINS} are reserved by tests that run")
