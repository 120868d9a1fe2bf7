"""Discovery where the network carries no multicast between pods: this process's own announcements, which the middleware
sends to a group, are passed on to the pods of the same agent one by one.

    own participant --> 239.255.0.1:7400 --> heard here (multicast loops back) --> every peer's port 7410, 7412, ...

The middleware (RTPS 2.3, 8.5.3 and 9.6) takes an announcement at its unicast port as it takes one at the group, and
answers by unicast from then on, so it is enough that one of two knows the other's address. Addresses are those of the
headless Service PEERS of the pod's namespace: where there is none, nothing is sent. Only processes in pods ask for it,
by its whole name: a short one would go on to the domains of the machine, of which one may have an answer to every name.
"""

from __future__ import annotations

import contextlib
import logging
import os
import random
import socket
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from robotkube.backoffs import backoff

PEERS = "ros-peers"  # as charts/robotkube names it
GROUP = "239.255.0.1"
BASE, OF_DOMAIN, UNICAST, OF_PARTICIPANT = 7400, 250, 10, 2  # RTPS 2.3, 9.6.1.1
PARTICIPANTS = 4  # processes of a pod that are looked for; each takes the first port that is free
MAGIC = b"RTPS"
SENDER = slice(8, 20)  # the sender's GUID prefix
PACKET_BYTES_MAX = 65536
POLL_SECONDS, POLL_SECONDS_MAX = 1.0, 10.0  # between looks for peers; the longest while there are none
HEAR_SECONDS_MAX = 0.5
AGAIN_SECONDS = 1.0  # between two announcements of one participant to a peer that has had one
IN_A_POD = "KUBERNETES_SERVICE_HOST"
DOMAIN = "ROS_DOMAIN_ID"
RESOLVER = Path("/etc/resolv.conf")

log = logging.getLogger(__name__)


def start(environment: Mapping[str, str] = os.environ) -> UnicastDiscovery | None:
    """Begin in a pod; None elsewhere."""
    if IN_A_POD not in environment:
        return None
    word = environment.get(DOMAIN, "")
    return UnicastDiscovery(int(word) if word.isdecimal() else 0)


def peers_name(resolver: str) -> str:
    """The whole name of the Service, by the file of the resolver that a kubelet writes: of its domains the first is
    that of the namespace's Services. Empty when it is none."""
    domains = [line.split()[1:] for line in resolver.splitlines() if line.startswith("search ")]
    first = domains[-1][0] if domains and domains[-1] else ""
    return f"{PEERS}.{first}." if first.split(".")[1:2] == ["svc"] else ""


def peers() -> frozenset[str]:
    """The addresses of all pods of this one's agent; none where there is no such Service."""
    try:
        name = peers_name(RESOLVER.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return frozenset()
    return addresses_of(name) if name else frozenset()


def addresses_of(name: str) -> frozenset[str]:
    """The IPv4 addresses behind a name; none when there is no such name, or nobody answers."""
    try:
        entries = socket.getaddrinfo(name, None, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError:
        return frozenset()
    return frozenset(str(entry[4][0]) for entry in entries)


class Announcements:
    """What is to be sent to whom: pure. `ports` are those at which a peer's processes listen."""

    def __init__(self, ports: Sequence[int]) -> None:
        self._ports = ports
        self._newest: dict[bytes, bytes] = {}  # by participant
        self._sent: dict[tuple[bytes, str], float] = {}
        self.peers: frozenset[str] = frozenset()

    def heard(self, packet: bytes) -> None:
        """Keep an announcement of this process; anything else is left."""
        if packet.startswith(MAGIC) and len(packet) >= SENDER.stop:
            self._newest[packet[SENDER]] = packet

    def due(self, now: float) -> list[tuple[bytes, str, int]]:
        """What to send now: packet, address and port."""
        due = []
        for sender, packet in self._newest.items():
            for peer in sorted(self.peers):
                if now - self._sent.get((sender, peer), -AGAIN_SECONDS) >= AGAIN_SECONDS:
                    self._sent[sender, peer] = now
                    due += [(packet, peer, port) for port in self._ports]
        return due

    def know(self, peers: Collection[str]) -> None:
        """These are the peers from now on."""
        self.peers = frozenset(peers)
        self._sent = {key: sent for key, sent in self._sent.items() if key[1] in self.peers}


class UnicastDiscovery:
    """Passes on what this process announces, on a thread of its own, until `close` or the process's end. `look` gives
    the addresses of all pods, `own` those of this one."""

    def __init__(
        self,
        domain: int,
        look: Callable[[], frozenset[str]] = peers,
        own: Callable[[], frozenset[str]] = lambda: addresses_of(socket.gethostname()),
    ) -> None:
        self._first = BASE + OF_DOMAIN * domain
        self._look = look
        self._own = own
        self._problem = ""
        self._announcements = Announcements([self._first + UNICAST + OF_PARTICIPANT * n for n in range(PARTICIPANTS)])
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="discovery", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Pass nothing on any more."""
        self._stopping.set()
        self._thread.join(HEAR_SECONDS_MAX + POLL_SECONDS)

    def _run(self) -> None:
        """Look for peers, ever more seldom while there are none."""
        failures = 0
        while not self._stopping.is_set():
            own = self._own()
            others = self._look() - own
            self._announcements.know(others)
            if others and not self._passed_on(own):
                others = frozenset()
            failures = 0 if others else failures + 1
            if not others:
                self._stopping.wait(backoff(failures, POLL_SECONDS, POLL_SECONDS_MAX, random.random))

    def _passed_on(self, own: frozenset[str]) -> bool:
        """Pass on until the next look; False when that failed. It is logged when it comes, when it is another problem,
        and when it has ended: each look meets what stays."""
        try:
            self._pass_on(own)
        except OSError as error:
            if str(error) != self._problem:
                log.warning("discovery: announcements are not passed on to peers: %s", error)
            self._problem = str(error)
            return False
        if self._problem:
            log.info("discovery: announcements are passed on to peers again")
        self._problem = ""
        return True

    def _pass_on(self, own: frozenset[str]) -> None:
        """Hear, until the next look, this process's own announcements and send them to peers. What others announce to
        the group came by multicast, and needs no help."""
        end = time.monotonic() + POLL_SECONDS
        with _listening(self._first, own) as heard, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
            while time.monotonic() < end and not self._stopping.is_set():
                with contextlib.suppress(TimeoutError):
                    packet, (source, _) = heard.recvfrom(PACKET_BYTES_MAX)
                    if source in own:
                        self._announcements.heard(packet)
                for packet, address, port in self._announcements.due(time.monotonic()):
                    with contextlib.suppress(OSError):  # it is sent again
                        sending.sendto(packet, (address, port))


@contextmanager
def _listening(port: int, own: Collection[str]) -> Iterator[socket.socket]:
    """A socket that hears the group beside the middleware's own, on the links that have these addresses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as heard:
        heard.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        heard.bind((GROUP, port))
        for address in own:
            joined = socket.inet_aton(GROUP) + socket.inet_aton(address)
            heard.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)
        heard.settimeout(HEAR_SECONDS_MAX)
        yield heard
