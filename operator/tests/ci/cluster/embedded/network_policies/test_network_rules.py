"""The nftables rules of NetworkPolicies mean what the policies do: random ones, and each way around them. What the
kernel makes of the same text: test_network_rules_nft.py."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

from hypothesis import given

from ci.cluster.embedded.network_policies.nftables_rules import TABLE, AttachedPod, Rulebook
from robotkube.foundation.kubernetes.core.network_policies import NetworkPeer, NetworkPolicy, may_connect, read_policy
from tests.stages.network.nft_meaning import PlacedPod
from tests.stages.network.random_policies import GROUP, NODES, OUTSIDE, PODS, POLICIES, PORTS, network

MANY = NetworkPeer("group", GROUP)
WEB, OTHER, STORE = (
    next(one for one in PODS if (one.peer.namespace, one.peer.name) == key)
    for key in (("shop", "web-one"), ("shop", "store-one"), ("bank", "store-two"))
)


def policy(namespace: str, name: str = "policy", **spec: object) -> NetworkPolicy:
    return read_policy({"metadata": {"namespace": namespace, "name": name}, "spec": {"podSelector": {}, **spec}})


DENY = policy("shop", "default-deny", policyTypes=["Ingress", "Egress"])


@given(POLICIES)
def test_every_pair_at_every_port_as_the_policies_say(policies: list[NetworkPolicy]) -> None:
    made = network(policies)
    for source, target in product((*PODS, *OUTSIDE), repeat=2):
        if source == target or not (source.node or target.node):
            continue
        for protocol, port in PORTS:
            wanted = may_connect(policies, source.peer, target.peer, protocol, port)
            passes = made.passes(source, target, protocol, port)
            assert passes == wanted.allowed, f"{source.peer} to {target.peer} at {protocol} {port}: {wanted.reason}"


@given(POLICIES)
def test_a_group_is_heard_by_whom_both_sides_allow(policies: list[NetworkPolicy]) -> None:
    made = network(policies)
    out = _only(policies, "egress")
    into = _only(policies, "ingress")
    for source, target in product(PODS, repeat=2):
        if source == target or source.node != target.node:
            continue
        for port in (53, 8080):
            wanted = (
                may_connect(out, source.peer, MANY, "UDP", port).allowed
                and may_connect(into, source.peer, target.peer, "UDP", port).allowed
            )
            assert made.heard(source, GROUP, target, port) == wanted


def _only(policies: Sequence[NetworkPolicy], direction: str) -> list[NetworkPolicy]:
    other = {"egress": "ingress", "ingress": "egress"}[direction]
    return [replace(one, **{other: None}) for one in policies]


@given(POLICIES)
def test_a_pod_reaches_its_node_by_what_its_policies_say_of_the_nodes_address(policies: list[NetworkPolicy]) -> None:
    made = network(policies)
    for one in PODS:
        node = NetworkPeer("node", "10.89.0.10")
        wanted = may_connect(policies, one.peer, node, "TCP", 10250).allowed
        assert made.ends_at_the_node(one, node.address, 10250) == wanted


@given(POLICIES)
def test_a_pod_without_rules_is_cut_off_whatever_the_policies_are(policies: list[NetworkPolicy]) -> None:
    """A new one, which its node has given an address, and nobody knows yet."""
    made = network(policies)
    for port in (WEB.port, "vethnew"):
        new = PlacedPod(NetworkPeer("new", "10.244.1.99", "shop"), "one", port)
        for other, (protocol, number) in product((*PODS, *OUTSIDE), PORTS):
            assert not made.passes(new, other, protocol, number)
            assert not made.passes(other, new, protocol, number)
        assert not made.heard(new, GROUP, WEB, 53)
        assert not made.heard(OTHER, GROUP, replace(new, port="vethnew"), 53)
        assert not made.ends_at_the_node(new, "10.89.0.10", 10250)


def test_nobody_sends_under_the_address_of_another() -> None:
    made = network([])
    assert made.passes(WEB, STORE, "TCP", 80)
    assert not made.passes(replace(WEB, port=OTHER.port), STORE, "TCP", 80)
    assert not made.heard(replace(WEB, port=OTHER.port), GROUP, OTHER, 53)


def test_an_address_that_two_pods_claim_is_nobodys() -> None:
    again = replace(STORE, peer=replace(STORE.peer, address=WEB.peer.address), node="one", port="vethagain")
    made = network([], [*PODS, again])
    assert not made.passes(WEB, STORE, "TCP", 80)
    assert not made.passes(again, STORE, "TCP", 80)
    assert not made.passes(STORE, WEB, "TCP", 80)
    assert made.passes(OTHER, STORE, "TCP", 80)


def test_a_pod_that_was_recorded_twice_with_one_address_keeps_it() -> None:
    assert network([], [*PODS, replace(WEB, peer=replace(WEB.peer))]).passes(WEB, STORE, "TCP", 80)


def test_a_pod_reaches_itself_through_a_service() -> None:
    assert network([DENY]).passes(WEB, WEB, "TCP", 80)


def test_peers_that_are_nobody_are_not_everybody() -> None:
    nobody = {"podSelector": {"matchLabels": {"app": "nobody"}}}
    made = network([DENY, policy("shop", "some", ingress=[{"from": [nobody]}], egress=[{"to": [nobody]}])])
    others = [one for one in PODS if one != WEB]
    assert not [one for one in others if made.passes(one, WEB, "TCP", 80) or made.passes(WEB, one, "TCP", 80)]


def test_rules_are_the_same_text_as_long_as_nothing_changes() -> None:
    """The order in which pods and policies are heard of says nothing."""
    some = policy("shop", "some", ingress=[{"from": [{"podSelector": {}}]}])
    attached = [AttachedPod(one.port, one.peer) for one in PODS if one.node == "one"]
    peers = [one.peer for one in PODS]
    once = Rulebook([DENY, some], peers).node(attached)
    assert Rulebook([some, DENY], peers[::-1]).node(attached[::-1]) == once
    assert once != Rulebook([DENY], peers).node(attached)


def test_what_was_there_is_replaced_in_one_step() -> None:
    begin = Rulebook([], []).node([]).splitlines()[:4]
    assert begin == [f"{word} {family} {TABLE}" for family in ("inet", "bridge") for word in ("table", "delete table")]


def test_a_drop_names_the_policies_that_select_the_pod() -> None:
    some = policy("shop", "some", ingress=[{"from": [{"podSelector": {}}]}])
    text = Rulebook([DENY, some], [one.peer for one in PODS]).node([AttachedPod(WEB.port, WEB.peer)])
    assert 'counter drop comment "shop: default-deny, some"' in text


def test_a_policy_is_about_pods_of_its_node_alone() -> None:
    assert all(f"{one.peer.address} :" not in _text("two") for one in PODS if one.node == "one")
    assert set(NODES) == {"one", "two"}


def _text(node: str) -> str:
    attached = [AttachedPod(one.port, one.peer) for one in PODS if one.node == node]
    return Rulebook([DENY], [one.peer for one in PODS]).node(attached)
