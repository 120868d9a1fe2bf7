"""The first process of the namespaces in which a Docker engine of the tests runs: it makes them ready, starts the
engine, and collects whatever becomes its child. All others end with it.

    python -m tests.stages.kind.first_process COMMAND...
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys

READY_SECONDS_MAX = 10
# A default route, which leads nowhere: programs ask for it when they look for an address of this machine.
NETWORK = (
    "ip link set lo up",
    "ip link add uplink type veth peer name nowhere",
    "ip address add 198.18.0.1/30 dev uplink",
    "ip link set uplink up",
    "ip link set nowhere up",
    "ip route add default dev uplink",
    "mount -t tmpfs tmpfs /run",
)


def main() -> None:
    for line in NETWORK:
        subprocess.run(line.split(), check=True, timeout=READY_SECONDS_MAX)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # who ends it kills it, and with it all others
    engine = subprocess.Popen(sys.argv[1:])
    while True:
        ended, code = os.wait()
        if ended == engine.pid:
            sys.exit(os.waitstatus_to_exitcode(code))


if __name__ == "__main__":
    main()
