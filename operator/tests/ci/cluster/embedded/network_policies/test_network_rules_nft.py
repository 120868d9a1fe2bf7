"""The kernel makes of the rules' text what policies mean: real connections between real network namespaces, on one node
and across nodes. Without the rules everybody reaches everybody there: the first test says so."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ci.cluster.embedded.network_policies import enforcement
from ci.cluster.embedded.network_policies.nftables_rules import TABLE
from ci.errors import SetUpError
from robotkube.foundation.kubernetes.core.network_policies import NetworkPeer, NetworkPolicy, may_connect, read_policy
from tests.stages.network import random_policies
from tests.stages.network.nft_meaning import PlacedPod
from tests.stages.network.real_nodes import HOST, HOST_ADDRESS, STRANGE, RealNodes, key
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

SERVICE = "10.96.0.10"
GROUP = "239.255.0.1"
DDS = 7400
AT = (("TCP", 8080), ("TCP", 9000), ("UDP", 8080))
HTTP = ("TCP", 8080)


def placed(namespace: str, name: str, node: int, number: int, **ports: int) -> PlacedPod:
    named = {("TCP", key): value for key, value in ports.items()}
    peer = NetworkPeer(name, f"10.244.{node}.{number}", namespace, {"app": name}, {"team": namespace}, named)
    return PlacedPod(peer, f"node-{node}", f"veth{namespace}{number}")


WEB = placed("shop", "web", 1, 2, http=8080)
STORE = placed("shop", "store", 1, 3)
FAR = placed("shop", "far", 2, 2, http=9000)
BANK = placed("bank", "bank", 1, 4)
FAR_BANK = placed("bank", "far", 2, 3)
PODS = (WEB, STORE, FAR, BANK, FAR_BANK)


def policy(name: str, selector: dict[str, str], **spec: object) -> NetworkPolicy:
    document = {"podSelector": {"matchLabels": selector}, **spec}
    return read_policy({"metadata": {"namespace": "shop", "name": name}, "spec": document})


TEAM = [{"podSelector": {}}]
BANKS = [{"namespaceSelector": {"matchLabels": {"team": "bank"}}}]
DENY = policy("deny", {}, policyTypes=["Ingress", "Egress"])
POLICIES = [
    DENY,
    policy("web", {"app": "web"}, ingress=[
        {"from": [{"podSelector": {"matchLabels": {"app": "store"}}}], "ports": [{"port": "http"}]},
        {"from": BANKS, "ports": [{"port": 8000, "endPort": 8999}]},
        {"from": [{"ipBlock": {"cidr": "10.89.0.0/24", "except": ["10.89.0.10/31"]}}], "ports": [{"port": 9000}]},
    ]),
    policy("far", {"app": "far"}, ingress=[{"from": TEAM, "ports": [{"protocol": "UDP", "port": 8080}]}]),
    policy("store", {"app": "store"}, policyTypes=["Egress"], egress=[{"to": TEAM}]),
    policy("out", {"app": "far"}, policyTypes=["Egress"], egress=[
        {"to": [{"namespaceSelector": {}}], "ports": [{"port": "http"}, {"port": 9000}]},
    ]),
]  # fmt: skip


def started(pods: Sequence[PlacedPod]) -> Iterator[RealNodes]:
    nodes = RealNodes(pods)
    try:
        nodes.start()
        yield nodes
    finally:
        nodes.close()


@pytest.fixture(scope="module")
def made() -> Iterator[RealNodes]:
    yield from started(PODS)


@pytest.fixture(scope="module")
def many() -> Iterator[RealNodes]:
    """The pods of the random policies."""
    yield from started(random_policies.PODS)


@pytest.fixture
def nodes(made: RealNodes) -> Iterator[RealNodes]:
    """With the rules of POLICIES."""
    made.enforce(POLICIES)
    yield made
    made.enforce([])


def reaches(nodes: RealNodes, source: PlacedPod, target: PlacedPod, at: tuple[str, int]) -> bool:
    return nodes.reaches(key(source), key(target), target.peer.address, at)


def test_without_rules_everybody_reaches_everybody(made: RealNodes) -> None:
    for node in made.nodes:
        made.inside(node, "nft", "flush", "ruleset")
    for source, target in product(PODS, repeat=2):
        if source != target:
            assert reaches(made, source, target, HTTP)


@pytest.mark.parametrize("at", AT)
def test_every_pair_as_the_policies_say(nodes: RealNodes, at: tuple[str, int]) -> None:
    for source, target in product(PODS, repeat=2):
        if source != target:
            wanted = may_connect(POLICIES, source.peer, target.peer, *at)
            assert reaches(nodes, source, target, at) == wanted.allowed, f"{key(source)} {key(target)}: {wanted.reason}"


def test_who_is_outside_and_the_other_way(nodes: RealNodes) -> None:
    host = NetworkPeer(HOST, HOST_ADDRESS)
    for pod, at in product((WEB, FAR, BANK), AT):
        into, out = (may_connect(POLICIES, *pair, *at).allowed for pair in ((host, pod.peer), (pod.peer, host)))
        assert nodes.reaches(HOST, key(pod), pod.peer.address, at) == into
        assert nodes.reaches(key(pod), HOST, HOST_ADDRESS, at) == out


@pytest.mark.thorough
@settings(max_examples=40)
@given(random_policies.POLICIES, st.data())
def test_random_policies_as_they_say(many: RealNodes, policies: list[NetworkPolicy], data: st.DataObject) -> None:
    many.enforce(policies)
    pairs = [pair for pair in product(random_policies.PODS, repeat=2) if pair[0] != pair[1]]
    ports = [at for at in random_policies.PORTS if at[0] != "SCTP"]
    for (source, target), at in data.draw(
        st.lists(st.tuples(st.sampled_from(pairs), st.sampled_from(ports)), max_size=6)
    ):
        wanted = may_connect(policies, source.peer, target.peer, *at)
        assert reaches(many, source, target, at) == wanted.allowed, f"{key(source)} {key(target)} {at}: {wanted.reason}"


def test_a_node_reaches_its_own_pods(nodes: RealNodes) -> None:
    """As kubelets do with their probes."""
    for pod in (WEB, STORE, FAR):
        assert nodes.reaches(pod.node, key(pod), pod.peer.address, HTTP)


def test_another_node_does_not(nodes: RealNodes) -> None:
    assert not nodes.reaches("node-2", key(STORE), STORE.peer.address, HTTP)
    assert nodes.reaches("node-2", key(BANK), BANK.peer.address, HTTP)


def test_a_pod_reaches_its_node_as_its_policies_say(nodes: RealNodes) -> None:
    address = nodes.address("node-1")
    assert not nodes.reaches(key(STORE), "node-1", address, HTTP)
    assert not nodes.reaches(key(WEB), "node-1", "10.244.1.1", HTTP)
    assert nodes.reaches(key(BANK), "node-1", address, HTTP)


def service(nodes: RealNodes, backend: PlacedPod) -> None:
    """A Service at 80 with this pod at 8080, on every node, as kube-proxy translates."""
    rules = f"""
table ip service
delete table ip service
table ip service {{
  chain prerouting {{
    type nat hook prerouting priority dstnat; policy accept;
    ip daddr {SERVICE} tcp dport 80 ip saddr != 10.244.0.0/16 meta mark set 0x4000
    ip daddr {SERVICE} tcp dport 80 ip saddr {backend.peer.address} meta mark set 0x4000
    ip daddr {SERVICE} tcp dport 80 dnat to {backend.peer.address}:8080
  }}
  chain postrouting {{
    type nat hook postrouting priority srcnat; policy accept;
    meta mark 0x4000 masquerade
  }}
}}
"""
    for node in nodes.nodes:
        nodes.inside(node, "nft", "-f", "-", text=rules)


@pytest.mark.parametrize("backend", [WEB, BANK, FAR])
def test_behind_a_service_the_pod_itself_is_judged(nodes: RealNodes, backend: PlacedPod) -> None:
    """Also when it is the one that asks."""
    service(nodes, backend)
    for source in PODS:
        wanted = may_connect(POLICIES, source.peer, backend.peer, *HTTP)
        reached = nodes.reaches(key(source), key(backend), SERVICE, ("TCP", 80), served=8080)
        assert reached == wanted.allowed, f"{key(source)}: {wanted.reason}"


def test_a_machine_that_asks_a_service_is_judged_by_its_own_address_on_the_node_that_translates(
    nodes: RealNodes,
) -> None:
    """A pod on another node sees that node's address instead."""
    nodes.inside(HOST, "ip", "route", "add", SERVICE, "via", nodes.address("node-1"))
    for pod, address in ((STORE, HOST_ADDRESS), (FAR, nodes.address("node-1"))):
        service(nodes, pod)
        at = ("TCP", 80)
        assert not nodes.reaches(HOST, key(pod), SERVICE, at, served=8080)
        nodes.enforce(
            [
                *POLICIES,
                policy("host", {"app": pod.peer.name}, ingress=[{"from": [{"ipBlock": {"cidr": f"{address}/32"}}]}]),
            ]
        )
        assert nodes.reaches(HOST, key(pod), SERVICE, at, served=8080)


def test_what_was_connected_stays_and_what_is_new_is_dropped(nodes: RealNodes) -> None:
    for target in (WEB, FAR):
        nodes.enforce([])
        with nodes.served(key(target), *HTTP) as server:
            client = nodes.open(key(BANK), lambda: socket.create_connection((target.peer.address, 8080), 5))  # noqa: B023
            with client:
                accepted = _accept(server)
                nodes.enforce([DENY])
                client.sendall(b"still here")
                accepted.settimeout(5)
                with accepted:
                    assert accepted.recv(100) == b"still here"
        assert not reaches(nodes, BANK, target, HTTP)


def _accept(server: socket.socket) -> socket.socket:
    server.settimeout(5)
    return server.accept()[0]


def test_a_pod_that_nobody_knows_is_cut_off(nodes: RealNodes) -> None:
    """A new one: from and to it nothing passes, whatever policies say, until it has rules."""
    known = [pod for pod in PODS if pod != BANK]
    nodes.enforce([], known)
    for other in (WEB, FAR, FAR_BANK):
        assert not reaches(nodes, other, BANK, HTTP)
        assert silent(nodes, BANK, other.peer.address)
    assert silent(nodes, BANK, nodes.address("node-1"))
    assert reaches(nodes, WEB, FAR, HTTP)
    nodes.enforce([], [*known, BANK])
    assert reaches(nodes, BANK, FAR, HTTP)
    assert reaches(nodes, WEB, BANK, HTTP)


def silent(nodes: RealNodes, source: PlacedPod, address: str) -> bool:
    """Return whether what a pod sends to an address is dropped where it leaves the pod."""
    before = nodes.drops().get(STRANGE, 0)
    with nodes.open(key(source), lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sender:
        sender.sendto(b"first", (address, 8080))
        until(lambda: nodes.drops()[STRANGE] > before, "it is dropped")
    return True


def test_nobody_sends_under_the_address_of_another(nodes: RealNodes) -> None:
    """BANK may reach WEB, STORE may not at this port: it takes BANK's address beside its own."""
    own = f"{BANK.peer.address}/32"
    nodes.inside(key(STORE), "ip", "addr", "add", own, "dev", "eth0")
    try:
        before = nodes.drops()[STRANGE]
        with nodes.served(key(WEB), "UDP", 8080) as server:
            with nodes.open(key(STORE), lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sender:
                sender.bind((BANK.peer.address, 5000))
                sender.sendto(b"first", (WEB.peer.address, 8080))
                until(lambda: nodes.drops()[STRANGE] > before, "it is dropped")
            with pytest.raises(BlockingIOError):
                server.recv(100)
    finally:
        nodes.inside(key(STORE), "ip", "addr", "del", own, "dev", "eth0")


def test_an_address_recorded_twice_keeps_its_rules(nodes: RealNodes) -> None:
    nodes.enforce(POLICIES, [*PODS, replace(WEB, port="vethbefore")])
    assert reaches(nodes, STORE, WEB, HTTP)


def test_a_group_is_heard_by_those_whose_policies_let_the_sender_in(nodes: RealNodes) -> None:
    """As processes of ROS 2 find each other, on one node."""
    allowed = policy(
        "group", {}, policyTypes=["Ingress", "Egress"], ingress=[{"from": TEAM}],
        egress=[{"to": [{"ipBlock": {"cidr": f"{GROUP}/32"}}], "ports": [{"protocol": "UDP", "port": DDS}]}],
    )  # fmt: skip
    nodes.enforce([DENY, allowed])
    with listening(nodes, WEB) as web, listening(nodes, STORE) as store, listening(nodes, BANK) as bank:
        shout(nodes, STORE)
        until(lambda: heard(web), "the neighbour hears it")
        until(lambda: heard(bank), "who has no policy hears it")
        dropped = nodes.drops()
        shout(nodes, BANK)
        until(lambda: nodes.drops()["shop: deny, group"] >= dropped["shop: deny, group"] + 2, "both drop it")
        assert not heard(web)
        assert not heard(store)
        nodes.enforce([DENY])
        dropped = nodes.drops()
        shout(nodes, STORE)
        until(lambda: nodes.drops()["shop: deny"] > dropped["shop: deny"], "it is not let out")
        assert not heard(web)
        assert not heard(bank)


def listening(nodes: RealNodes, pod: PlacedPod) -> socket.socket:
    def made() -> socket.socket:
        bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        bound.bind((GROUP, DDS))
        member = struct.pack("4s4s", socket.inet_aton(GROUP), socket.inet_aton(pod.peer.address))
        bound.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        bound.setblocking(False)
        return bound

    return nodes.open(key(pod), made)


def shout(nodes: RealNodes, pod: PlacedPod) -> None:
    with nodes.open(key(pod), lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sender:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 0)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(pod.peer.address))
        sender.sendto(b"here", (GROUP, DDS))


def heard(listener: socket.socket) -> bool:
    try:
        return listener.recv(100) == b"here"
    except BlockingIOError:
        return False


def test_while_rules_are_replaced_nothing_slips_through(nodes: RealNodes) -> None:
    """Datagrams all the time, rules replaced over and over: none arrives."""
    with nodes.served(key(STORE), "UDP", 8080) as server:
        with nodes.open(key(BANK), lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sender:
            for _ in range(30):
                for _ in range(50):
                    sender.sendto(b"first", (STORE.peer.address, 8080))
                nodes.enforce(POLICIES)
        with pytest.raises(BlockingIOError):
            server.recv(100)


def test_a_node_is_closed_before_its_first_pod(nodes: RealNodes) -> None:
    for node in nodes.nodes:
        nodes.inside(node, "nft", "flush", "ruleset")
        enforcement.close(nodes.holder(node))
        assert f"table bridge {TABLE}" in nodes.inside(node, "nft", "list", "tables")
    assert silent(nodes, WEB, FAR.peer.address)


def test_a_node_that_could_not_enforce_anything_between_its_pods_is_refused(nodes: RealNodes) -> None:
    """Without br_netfilter the rules do not see what passes the bridge."""
    nodes.inside("node-1", "sh", "-c", f"echo 0 > {enforcement.FILTERING}")
    try:
        with pytest.raises(SetUpError, match="modprobe br_netfilter"):
            enforcement.close(nodes.holder("node-1"))
    finally:
        nodes.inside("node-1", "sh", "-c", f"echo 1 > {enforcement.FILTERING}")


def test_rules_that_nft_does_not_take_leave_the_old_ones(nodes: RealNodes) -> None:
    with pytest.raises(SetUpError, match="nft"):
        enforcement.apply(nodes.holder("node-1"), f"delete table inet {TABLE}\nwhatever\n")
    assert not reaches(nodes, BANK, STORE, HTTP)
