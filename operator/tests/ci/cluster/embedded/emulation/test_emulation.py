"""The kernel does to cables what was asked for: real network namespaces, token buckets, nftables and the relay.
Bounds are wide where the machine does other things as well; each test lasts a second or two."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest

from ci.cluster.embedded.emulation import relay, rules
from ci.cluster.embedded.emulation.emulating import NetworkEmulation
from ci.cluster.embedded.host import processes
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network import host_network
from ci.cluster.embedded.network.namespaces import inside
from ci.cluster_contract.network_conditions import NetworkConditions
from ci.errors import SetUpError
from tests.stages.network.emulated_cables import EmulatedCables
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

AGENT = "vehicle-00"
MOBILE = NetworkConditions(up_mbit=2, down_mbit=4, round_trip_ms=50, jitter_ms=15, loss_percent=3)
LENGTH, PORT = 400_000, 7000
TCP_INFO_TOTAL_RETRANSMITS = slice(100, 104)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[EmulatedCables, NetworkEmulation]]:
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cables")
        patch.setenv("XDG_CACHE_HOME", str(folder))
        cables = EmulatedCables(ClusterFolders(f"e{abs(hash(folder)) % 1000}"))
        try:
            yield cables, cables.start()
        finally:
            cables.on_host(lambda: processes.kill_all(cables.folders.name))
            cables.close()


@pytest.fixture
def cables(made: tuple[EmulatedCables, NetworkEmulation]) -> Iterator[EmulatedCables]:
    """The machine; afterwards no cable has conditions."""
    yield made[0]
    made[0].on_host(made[1].clear)


@pytest.fixture
def emulation(made: tuple[EmulatedCables, NetworkEmulation]) -> NetworkEmulation:
    return made[1]


def state(cables: EmulatedCables) -> list[str]:
    """Everything of the network that an emulation may change."""
    lines = []
    for place in ("host", AGENT):
        lines += [line.split(" state ")[0] for line in cables.said(place, "ip", "-d", "-o", "link").splitlines()]
        lines += [cables.said(place, "tc", "qdisc"), cables.said(place, "nft", "list", "tables")]
        lines += [word for word in cables.said(place, "bridge", "link").split() if word in ("master", "rk")]
    return lines


def crossing(cables: EmulatedCables, length: int = LENGTH) -> tuple[bytes, int]:
    """What comes of so many bytes sent upwards by TCP; how many packets were sent again."""
    server = inside(cables.namespace("platform-0"), socket.socket)
    server.bind((cables.ends.far_address, 0))
    server.listen()
    client = inside(cables.namespace(AGENT), socket.socket)
    sent: list[int] = []

    def send() -> None:
        client.connect(server.getsockname())
        client.sendall(b"x" * length)
        client.shutdown(socket.SHUT_WR)

    thread = threading.Thread(target=send)
    thread.start()
    server.settimeout(20)
    connection, _ = server.accept()
    connection.settimeout(20)
    received = b""
    while data := connection.recv(65536):
        received += data
    thread.join()
    info = client.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 104)
    sent.append(int.from_bytes(info[TCP_INFO_TOTAL_RETRANSMITS], "little"))
    for one in (connection, server, client):
        one.close()
    return received, sent[0]


def test_a_cable_is_as_asked_for_and_a_probe_says_so(cables: EmulatedCables, emulation: NetworkEmulation) -> None:
    acts = cables.on_host(lambda: emulation.apply({AGENT: MOBILE}))
    measured = cables.on_host(emulation.probe)[AGENT]
    traffic = cables.on_host(lambda: emulation.traffic(AGENT))
    least, median, _ = measured.round_trip_ms or (0, 0, 0)
    assert least >= 35
    assert median >= 40
    assert 0.5 * 2 <= (measured.up_mbit or 0) <= 1.3 * 2
    assert 0.5 * 4 <= (measured.down_mbit or 0) <= 1.3 * 4
    assert 0 < measured.lost < 0.2 * measured.sent
    assert traffic["up"].lost + traffic["down"].lost == pytest.approx(measured.lost, abs=10)
    assert traffic["up"].in_holes == traffic["down"].in_holes == 0
    assert any(text.startswith("delay: relay") for text in acts[AGENT])


def test_what_is_lost_is_sent_again_by_its_sender(cables: EmulatedCables, emulation: NetworkEmulation) -> None:
    cables.on_host(lambda: emulation.apply({AGENT: NetworkConditions(loss_percent=5, round_trip_ms=10)}))
    received, again = crossing(cables)
    traffic = cables.on_host(lambda: emulation.traffic(AGENT))
    assert received == b"x" * LENGTH
    assert again > 0
    assert traffic["up"].lost > 0
    assert traffic["up"].packets >= LENGTH // 1500, "large packets were cut before they could be lost"


def test_a_hole_drops_everything_for_its_time(cables: EmulatedCables, emulation: NetworkEmulation) -> None:
    cables.on_host(lambda: emulation.apply({AGENT: NetworkConditions(up_mbit=100)}))
    cables.on_host(lambda: emulation.cut(AGENT, 60))
    ends = cables.ends
    near, far = (
        inside(place, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for place in (ends.near, ends.far)
    )
    far.bind((ends.far_address, 0))
    far.settimeout(0.2)
    near.sendto(b"in the hole", far.getsockname())
    until(lambda: cables.on_host(lambda: emulation.traffic(AGENT))["up"].in_holes > 0)
    with pytest.raises(TimeoutError):
        far.recv(100)
    cables.on_host(lambda: emulation.apply({AGENT: NetworkConditions(up_mbit=100)}))
    cables.on_host(lambda: emulation.cut(AGENT, 0.05))
    far.settimeout(0.05)

    def arrives() -> bool:
        near.sendto(b"behind it", far.getsockname())
        try:
            return far.recv(100) == b"behind it"
        except TimeoutError:
            return False

    until(arrives, "it ends by itself")
    near.close()
    far.close()


def test_everything_is_as_before_when_it_is_taken_away(cables: EmulatedCables, emulation: NetworkEmulation) -> None:
    before = state(cables)
    cables.on_host(lambda: emulation.apply({AGENT: MOBILE}))
    assert state(cables) != before
    assert processes.recorded(cables.folders, relay.NAME)
    cables.on_host(emulation.clear)
    assert state(cables) == before
    assert not processes.recorded(cables.folders, relay.NAME)
    assert sorted(path.name for path in cables.folders.base.iterdir() if path.is_file()) == []


def test_what_a_killed_run_has_left_is_taken_away_by_the_next(
    cables: EmulatedCables, emulation: NetworkEmulation
) -> None:
    before = state(cables)
    cables.on_host(lambda: emulation.apply({AGENT: MOBILE}))
    [relay_process] = processes.recorded(cables.folders, relay.NAME)
    another = NetworkEmulation(emulation._plan, emulation._launcher, emulation._nodes)
    cables.on_host(another.clear)
    assert state(cables) == before
    assert not relay_process.alive()


def test_the_bridge_keeps_its_address_when_ports_come_and_go(
    cables: EmulatedCables, emulation: NetworkEmulation
) -> None:
    """Fails where the kernel chooses it: the least of its ports' addresses, to which nodes would go on speaking."""
    cables.on_host(lambda: emulation.apply({AGENT: NetworkConditions(round_trip_ms=5)}))
    shown = cables.said("host", "ip", "-o", "link", "show", cables.plan.bridge)
    assert cables.plan.hardware_address in shown


def test_what_cannot_be_done_changes_nothing(
    cables: EmulatedCables, emulation: NetworkEmulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = state(cables)
    with pytest.raises(SetUpError, match=r"has 0 nodes of agent vehicle-07"):
        cables.on_host(lambda: emulation.apply({"vehicle-07": MOBILE}))
    monkeypatch.setattr(rules, "BURST_BYTES", -1)
    with pytest.raises(SetUpError, match="tc qdisc replace dev eth0"):
        cables.on_host(lambda: emulation.apply({AGENT: MOBILE}))
    assert state(cables) == before


def test_a_cluster_that_is_removed_leaves_nothing_of_it(cables: EmulatedCables, emulation: NetworkEmulation) -> None:
    cables.on_host(lambda: emulation.apply({AGENT: MOBILE}))
    plan = cables.plan
    assert len(cables.on_host(lambda: host_network.links(plan))) == 5
    assert len(cables.on_host(lambda: host_network.tables(plan))) == 2
    cables.on_host(lambda: host_network.remove(plan))
    assert cables.on_host(lambda: (*host_network.links(plan), *host_network.tables(plan))) == ()
