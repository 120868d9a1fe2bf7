"""Robot processes as pods see the world, without a cluster: nodes are bridges, pods are network namespaces on them.

DDS multicast stays on a node, as on a cluster's nodes; every node reaches the broker and the API server, which run on
the machine itself. Everything made carries the prefix of the instance and is taken away by `close`.
"""

from __future__ import annotations

import contextlib
import errno
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ci.errors import SetUpError
from ci.folders import PROJECT
from robotkube.foundation.certificates.adapters.issuing import throw_away

STOP_SECONDS_MAX = 5.0
START_SECONDS_MAX = 10.0
LINK_SECONDS_MAX = 10.0
SECOND_BYTES = range(246, 255)  # behind those of the clusters
PORTS = (12_000, 30_000)  # above the well-known ones, below node ports and the kernel's own choice
PORT_TRIALS_MAX = 100
_given: set[int] = set()
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")

BROKER_SETTINGS = """
listener {port} 0.0.0.0
allow_anonymous false
password_file {folder}/passwords
acl_file {folder}/acl
set_tcp_nodelay true
max_inflight_messages 100
max_queued_messages 50000
max_queued_bytes 134217728
message_size_limit 16777216
queue_qos0_messages false
persistence {persistence}
persistence_location {folder}/
sys_interval 0
connection_messages false
"""


@dataclass
class Pod:
    """A running process and the name under which its cost is counted."""

    component: str
    process: subprocess.Popen[bytes]

    def cpu_seconds(self) -> float:
        """User and system time so far; 0 when it has ended."""
        try:
            text = Path(f"/proc/{self.process.pid}/stat").read_text()
        except OSError:
            return 0.0
        fields = text[text.rindex(")") + 2 :].split()
        return (int(fields[11]) + int(fields[12])) / CLOCK_TICKS

    def memory_bytes(self) -> int:
        """Resident memory now."""
        try:
            return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        except (OSError, IndexError):
            return 0

    def stop(self, number: int = signal.SIGTERM) -> None:
        """End it, by force after a bounded time."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            self.process.wait(STOP_SECONDS_MAX)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(STOP_SECONDS_MAX)


@dataclass
class Nodes:
    """Bridges and namespaces; `mtu` of all links. `second` is the second byte of the addresses 10.x.n.p, and all names
    begin with it: the first of SECOND_BYTES that nobody beside uses."""

    mtu: int = 1500
    second: int = 0
    _bridges: list[str] = field(default_factory=list)
    _namespaces: list[str] = field(default_factory=list)

    @property
    def prefix(self) -> str:
        return f"rk{self.second}"

    def node(self) -> int:
        """A new node; its number."""
        number = len(self._bridges)
        if not number:
            self.second = _claim()
        else:
            _ip("link", "add", f"{self.prefix}b{number}", "type", "bridge")
        bridge = f"{self.prefix}b{number}"
        self._bridges.append(bridge)
        _ip("addr", "add", f"{self.gateway(number)}/24", "dev", bridge)
        _ip("link", "set", bridge, "mtu", str(self.mtu), "up")
        return number

    def gateway(self, node: int) -> str:
        """The machine's address on a node's network."""
        return f"10.{self.second}.{node}.1"

    def pod(self, node: int) -> str:
        """A new namespace on a node; its name."""
        number = len(self._namespaces)
        name, link = f"{self.prefix}p{number}", f"{self.prefix}v{number}"
        _ip("netns", "add", name)
        self._namespaces.append(name)
        _ip("link", "add", link, "type", "veth", "peer", "name", "eth0", "netns", name)
        _ip("link", "set", link, "master", self._bridges[node], "mtu", str(self.mtu), "up")
        _ip("-n", name, "link", "set", "lo", "up")
        _ip("-n", name, "addr", "add", f"{self.address(node, name)}/24", "dev", "eth0")
        _ip("-n", name, "link", "set", "eth0", "mtu", str(self.mtu), "up")
        _ip("-n", name, "route", "add", "default", "via", self.gateway(node))
        self._await_link(name)
        return name

    @staticmethod
    def _await_link(pod: str) -> None:
        """Wait until the link has its carrier: a ROS node that is made before hears nobody for ever."""
        end = time.monotonic() + LINK_SECONDS_MAX
        while " state UP " not in _ip("-n", pod, "-o", "link", "show", "eth0"):
            if time.monotonic() >= end:
                raise SetUpError(f"{pod}: eth0 has no carrier after {LINK_SECONDS_MAX:.0f} s")
            time.sleep(0.01)

    def address(self, node: int, pod: str) -> str:
        """The address of a namespace on its node's network."""
        return f"10.{self.second}.{node}.{10 + int(pod.rpartition('p')[2])}"

    def close(self) -> None:
        """Take all of it away: what claims these names next finds them free. The links first, because with a namespace
        they go some time later."""
        for number in range(len(self._namespaces)):
            subprocess.run(["ip", "link", "delete", f"{self.prefix}v{number}"], capture_output=True, check=False)
        for name in self._namespaces:
            subprocess.run(["ip", "netns", "delete", name], capture_output=True, check=False)
        for bridge in self._bridges:
            subprocess.run(["ip", "link", "delete", bridge], capture_output=True, check=False)


def _claim() -> int:
    """A second byte that nobody uses; its first bridge says so to others, and stands now."""
    for second in SECOND_BYTES:
        command = ["ip", "link", "add", f"rk{second}b0", "type", "bridge"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if not done.returncode:
            return second
        if "File exists" not in done.stderr:
            raise SetUpError(f"{' '.join(command)}: {done.stderr.strip()}; network namespaces need root")
    raise SetUpError(f"all networks 10.x with x in {SECOND_BYTES} are used: take away what `ip link` shows as rk<x>b0")


def _ip(*arguments: str) -> str:
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SetUpError(f"ip {' '.join(arguments)}: {done.stderr.strip()}; network namespaces need root")
    return done.stdout


def start(
    component: str, command: Sequence[str], environment: Mapping[str, str], log: Path, namespace: str | None = None
) -> Pod:
    """Start a process in the environment of the ros image, in a network namespace if one is named; stderr and stdout go
    to `log`."""
    inherited = {key: os.environ[key] for key in ("PATH", "LD_LIBRARY_PATH", "TMPDIR") if key in os.environ}
    entering = ["nsenter", f"--net=/run/netns/{namespace}"] if namespace else []
    full = {
        **inherited,
        "HOME": str(log.parent),
        "ROS_LOG_DIR": str(log.parent / "ros"),
        "PYTHONPATH": f"{PROJECT / 'operator' / 'src'}:{PROJECT}",
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",
        "OPENBLAS_NUM_THREADS": "1",
        **environment,
    }
    with log.open("ab") as output:
        process = subprocess.Popen(
            [*entering, *command], stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=full
        )
    return Pod(component, process)


def python(module: str, *arguments: str) -> list[str]:
    """Command of a module with this interpreter."""
    return [sys.executable, "-m", module, *arguments]


def free_port() -> int:
    """A loopback TCP port nobody listens on at this moment.

    Drawn below those that the kernel gives to outgoing connections, so that nothing takes it before its server does,
    or while its server is away, and at random, so that others beside draw others. A server may listen much later, and
    now and then only: no port is given twice, and workers of one test run draw from ports of their own.
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
    raise SetUpError(f"no free port among {PORT_TRIALS_MAX} of {PORTS}")


@dataclass
class Broker:
    """A mosquitto with accounts and ACL as the platform's chart makes them; can be stopped and started again.
    `encrypted`: it speaks TLS alone."""

    folder: Path
    accounts: Mapping[str, Sequence[str]]  # account -> lines of its ACL
    persistence: bool = False
    encrypted: bool = False
    port: int = field(default_factory=free_port)
    pod: Pod | None = None

    def __post_init__(self) -> None:
        if shutil.which("mosquitto") is None:
            raise SetUpError("mosquitto is not installed; run: apt-get install -y --no-install-recommends mosquitto")
        self.folder.mkdir(parents=True, exist_ok=True)
        acl = []
        passwords = self.folder / "passwords"
        passwords.touch(mode=0o600)
        for account, lines in self.accounts.items():
            acl += [f"user {account}", *lines, ""]
            subprocess.run(
                ["mosquitto_passwd", "-b", str(passwords), account, password(account)], check=True, capture_output=True
            )
        (self.folder / "acl").write_text("\n".join(acl))
        (self.folder / "acl").chmod(0o600)
        settings = BROKER_SETTINGS.format(port=self.port, folder=self.folder, persistence=str(self.persistence).lower())
        if self.encrypted:
            self._certify()
            files = f"certfile {self.folder}/tls.crt\nkeyfile {self.folder}/tls.key\n"
            settings = settings.replace(" 0.0.0.0\n", f" 0.0.0.0\n{files}", 1)
        (self.folder / "mosquitto.conf").write_text(settings + "user root\n")

    def _certify(self) -> None:
        """A certificate for the name `broker`, whatever the address."""
        issued = throw_away("broker")
        for name, text in (
            ("ca.crt", issued.authority),
            ("tls.crt", issued.pair.certificate),
            ("tls.key", issued.pair.key),
        ):
            (self.folder / name).write_text(text)

    def start(self) -> None:
        """Returns when it takes connections."""
        command = ["mosquitto", "-c", str(self.folder / "mosquitto.conf")]
        self.pod = start("broker", command, {"GLIBC_TUNABLES": ""}, self.folder / "log")  # an image of its own
        deadline = time.monotonic() + START_SECONDS_MAX
        while time.monotonic() < deadline:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
                return
            time.sleep(0.02)
        raise SetUpError(f"mosquitto does not start; see {self.folder / 'log'}")

    def stop(self, number: int = signal.SIGTERM) -> None:
        """End it."""
        if self.pod is not None:
            self.pod.stop(number)

    def secret(self, account: str, host: str) -> Path:
        """A folder like the mounted Secret broker-account; its parent is what ROBOTKUBE_SECRETS names."""
        folder = self.folder / "secrets" / account / "broker"
        folder.mkdir(parents=True, exist_ok=True)
        values = {"username": account, "password": password(account), "host": host, "port": str(self.port)}
        if self.encrypted:
            authority = (self.folder / "ca.crt").read_text()
            values |= {"tls": "required", "server_name": "broker", "ca.crt": authority}
        for key, value in values.items():
            (folder / key).write_text(value)
        return folder.parent


def password(account: str) -> str:
    """The account's password in a measurement."""
    return f"secret of {account}"


def vehicle_rules(agent: str) -> list[str]:
    """ACL of a vehicle."""
    own = f"mqtt/vehicles/{agent.replace('-', '_')}/#"
    return [f"topic readwrite {prefix}{own}" for prefix in PREFIXES]


PREFIXES = ("", "robotkube/types/", "mqtt_client/ros_msg_type/")
CLOUD_RULES = [f"topic read {prefix}mqtt/#" for prefix in PREFIXES]
