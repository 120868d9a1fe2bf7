"""What a process announces is passed on to peers where the network carries no multicast: what is sent to whom, and that
two processes of ROS 2 find each other by it."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from robotkube.robots.ros.adapters import unicast_discovery
from robotkube.robots.ros.adapters.unicast_discovery import (
    BASE,
    GROUP,
    OF_DOMAIN,
    Announcements,
    UnicastDiscovery,
    peers_name,
)
from tests.stages.waiting import until

DOMAIN = 173
PORT = BASE + OF_DOMAIN * DOMAIN
FIRST, SECOND = b"RTPS\2\3\1\x0f" + b"a" * 12 + b"rest", b"RTPS\2\3\1\x0f" + b"b" * 12 + b"rest"


def test_each_peer_gets_each_participants_newest_word() -> None:
    announcements = Announcements([7410, 7412])
    announcements.heard(FIRST)
    assert announcements.due(0.0) == []
    announcements.know({"10.0.0.2"})
    assert announcements.due(0.0) == [(FIRST, "10.0.0.2", 7410), (FIRST, "10.0.0.2", 7412)]
    assert announcements.due(0.5) == []
    announcements.heard(SECOND)
    announcements.heard(FIRST + b", again")
    assert [packet for packet, _, _ in announcements.due(0.5)] == [SECOND] * 2
    announcements.know({"10.0.0.2", "10.0.0.3"})
    assert {peer for _, peer, _ in announcements.due(0.6)} == {"10.0.0.3"}
    assert {packet for packet, _, _ in announcements.due(1.5)} == {FIRST + b", again", SECOND}


def test_a_peer_that_comes_back_is_told_at_once() -> None:
    announcements = Announcements([7410])
    announcements.heard(FIRST)
    announcements.know({"10.0.0.2"})
    assert announcements.due(0.0)
    announcements.know(())
    announcements.know({"10.0.0.2"})
    assert announcements.due(0.1)


@pytest.mark.parametrize("packet", [b"", b"RTPS", b"RTPX" + b"a" * 40])
def test_what_is_no_announcement_is_left(packet: bytes) -> None:
    announcements = Announcements([7410])
    announcements.know({"10.0.0.2"})
    announcements.heard(packet)
    assert announcements.due(0.0) == []


@pytest.mark.parametrize(
    ("resolver", "name"),
    [
        ("search vehicle-00.svc.cluster.local svc.cluster.local cluster.local example.com\nnameserver 10.96.0.10\n"
         "options ndots:5\n", "ros-peers.vehicle-00.svc.cluster.local."),
        ("nameserver 10.96.0.10\nsearch cloud-0.svc.robots.example\n", "ros-peers.cloud-0.svc.robots.example."),
        ("search example.com svc.cluster.local\nnameserver 192.0.2.1\n", ""),
        ("search \n", ""),
        ("nameserver 192.0.2.1\n", ""),
        ("", ""),
    ],
)  # fmt: skip
def test_peers_are_asked_for_in_the_namespace_alone(resolver: str, name: str) -> None:
    assert peers_name(resolver) == name


def test_outside_of_a_pod_nothing_is_begun() -> None:
    assert unicast_discovery.start({}) is None


@pytest.fixture
def peer() -> Iterator[socket.socket]:
    """A peer's second port, at an address of this machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.7", PORT + 12))
        listening.settimeout(0.2)
        yield listening


def test_what_this_process_announces_arrives_at_a_peer(peer: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unicast_discovery, "POLL_SECONDS", 0.1)
    announced: list[frozenset[str]] = []
    answers = iter([frozenset[str](), frozenset({"127.0.0.1"})])  # no such Service; and nobody else is there

    def look() -> frozenset[str]:
        announced.append(next(answers, frozenset({"127.0.0.1", "127.0.0.7"})))
        return announced[-1]

    passing = UnicastDiscovery(DOMAIN, look, lambda: frozenset({"127.0.0.1"}))
    try:
        until(lambda: told(peer, "127.0.0.1", FIRST), "the peer hears it")
        assert len(announced) > 2
        assert not any(told(peer, "127.0.0.9", SECOND) for _ in range(3)), "another one's was passed on"
    finally:
        passing.close()
    assert not passing._thread.is_alive()


def test_a_problem_is_logged_once_until_it_is_another_one_or_ends(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The addresses of the pod are on no link of it, as while its network is not up; then they are none at all."""
    monkeypatch.setattr(unicast_discovery, "POLL_SECONDS", 0.02)
    monkeypatch.setattr(unicast_discovery, "POLL_SECONDS_MAX", 0.02)
    caplog.set_level("INFO", "robotkube")
    own = ["192.0.2.1"]
    looks: list[str] = []

    def look() -> frozenset[str]:
        looks.append(own[0])
        return frozenset({"127.0.0.7"})

    def logged() -> list[tuple[str, str]]:
        return [
            (record.levelname, record.getMessage())
            for record in caplog.records
            if record.name == unicast_discovery.__name__
        ]

    def after_looks(number: int, address: str) -> None:
        own[0] = address
        until(lambda: looks.count(address) >= number, f"{number} looks with {address}")

    passing = UnicastDiscovery(DOMAIN + 1, look, lambda: frozenset({own[0]}))
    try:
        after_looks(5, "192.0.2.1")
        [(level, problem)] = logged()
        assert level == "WARNING"
        assert problem.startswith("discovery: announcements are not passed on to peers: ")
        after_looks(5, "no address")
        assert len(logged()) == 2
        assert logged()[1][1] not in ("", problem)
        after_looks(3, "127.0.0.1")
        assert logged()[2:] == [("INFO", "discovery: announcements are passed on to peers again")]
        after_looks(10, "192.0.2.1")
        until(lambda: len(logged()) == 4, "it has begun again")
        assert logged()[3] == ("WARNING", problem)
    finally:
        passing.close()


def told(peer: socket.socket, source: str, packet: bytes) -> bool:
    """Return whether the peer has a packet that somebody at this address sent to the group."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as announcing:
        announcing.bind((source, 0))
        announcing.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        announcing.sendto(packet, (GROUP, PORT))
    try:
        return any(peer.recv(100) == packet for _ in range(5))
    except TimeoutError:
        return False
