"""A ROS domain of this test process's own: nodes of other test processes beside it are never heard."""

import functools
import os
import socket

DOMAINS = range(100, 200)
_claims: list[socket.socket] = []


@functools.cache
def domain() -> str:
    """For ROS_DOMAIN_ID; claimed on this machine until the process ends."""
    for offset in range(len(DOMAINS)):
        number = DOMAINS[(os.getpid() + offset) % len(DOMAINS)]
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0robotkube-tests-ros-domain-{number}")
        except OSError:
            claim.close()
            continue
        _claims.append(claim)
        return str(number)
    raise AssertionError(f"all ROS domains of {DOMAINS} are claimed by tests that run")
