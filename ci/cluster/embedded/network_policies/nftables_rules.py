"""NetworkPolicies as nftables rules of one node: who may reach whom, as text for `nft -f`, which replaces what was
there in one step. Pure.

What goes out of a pod is judged on its own node, and so is what comes in; of two pods of one node both. The rules see
addresses as they are between the two translations of kube-proxy: the address of the pod behind a Service, and that of
who really asks. What the node itself sends to its pods is not judged, and answers belong to their connection.

    table inet     what passes the node (forward) or ends at it (input) and comes from, or goes to, the bridge of its
                   pods
    table bridge   frames between the ports of that bridge: each port sends under its own address and nothing but IPv4
                   and ARP; frames for many (multicast, by which ROS 2 finds itself) are judged at each port that they
                   leave by

An address that no pod is known to have reaches nothing and is not reached. So a new pod is cut off until its node has
rules for it, and it has them only together with those of every policy that selects it.

The inet table sees frames of the bridge only with br_netfilter (net.bridge.bridge-nf-call-iptables) in the node.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network, IPv6Network, collapse_addresses

from robotkube.foundation.kubernetes.core.network_policies import (
    Block,
    NetworkPeer,
    NetworkPolicy,
    PolicyRule,
    Port,
)

TABLE = "robotkube-network-policies"
BRIDGE = "cni0"  # of the node's pods
EGRESS, INGRESS = "egress", "ingress"
EVERYBODY = (IPv4Network("0.0.0.0/0"),)
COMMENT_CHARACTERS_MAX = 120  # nft takes 128
UNKNOWN = "of no known pod"

Networks = tuple[IPv4Network, ...]


@dataclass(frozen=True)
class AttachedPod:
    """A pod of the node, and the port of the node's bridge behind which it stands."""

    port: str
    pod: NetworkPeer


@dataclass(frozen=True)
class _Chain:
    """What one direction of a pod allows: conditions, one of which must hold, and the policies that say so."""

    conditions: tuple[str, ...]
    policies: str


class Rulebook:
    """The rules of every node, from all policies and all pods of the cluster that have an address. An address that two
    pods claim is nobody's."""

    def __init__(self, policies: Sequence[NetworkPolicy], pods: Iterable[NetworkPeer]) -> None:
        different = {_identity(pod): pod for pod in pods}
        pods_of_address = Counter(address for address, _ in different)
        self._policies = policies
        self._pods = {key: pod for key, pod in different.items() if pods_of_address[pod.address] == 1}
        self._addresses: dict[tuple[str, str, str, int], Networks] = {}

    def node(self, attached: Iterable[AttachedPod]) -> str:
        """The rules of the node that these pods are attached to."""
        own = sorted((one for one in attached if _identity(one.pod) in self._pods), key=_place)
        leaving = _Direction("leaving", own, [self._chain(one.pod, EGRESS) for one in own])
        arriving = _Direction("arriving", own, [self._chain(one.pod, INGRESS) for one in own])
        lines = [*_replaced("inet"), *_replaced("bridge")]
        lines += [f"table inet {TABLE} {{", *_inet(own, leaving, arriving), "}"]
        lines += [f"table bridge {TABLE} {{", *_bridge(own, arriving), "}"]
        return "\n".join(lines) + "\n"

    def _chain(self, pod: NetworkPeer, direction: str) -> _Chain | None:
        """What a pod's direction allows; None when no policy isolates it there."""
        selecting = [one for one in self._policies if getattr(one, direction) is not None and one.selects(pod)]
        if not selecting:
            return None
        conditions: set[str] = set()
        for policy in selecting:
            for number, rule in enumerate(getattr(policy, direction)):
                to = self._networks(policy, direction, number, rule)
                conditions.update(self._conditions(rule, to, direction, pod))
        return _Chain(tuple(sorted(conditions)), _names(selecting))

    def _networks(self, policy: NetworkPolicy, direction: str, number: int, rule: PolicyRule) -> Networks:
        """The addresses that a rule's peers have: computed once, since policies select many pods."""
        key = (policy.namespace, policy.name, direction, number)
        if key not in self._addresses:
            self._addresses[key] = tuple(collapse_addresses(self._peers(policy.namespace, rule)))
        return self._addresses[key]

    def _peers(self, namespace: str, rule: PolicyRule) -> Iterator[IPv4Network]:
        if not rule.peers:
            yield from EVERYBODY
        for peer in rule.peers:
            if peer.block is not None:
                yield from _block(peer.block)
                continue
            yield from (IPv4Network(pod.address) for pod in self._pods.values() if peer.holds(namespace, pod))

    def _conditions(self, rule: PolicyRule, to: Networks, direction: str, pod: NetworkPeer) -> Iterator[str]:
        """Each of them lets a connection through; none when nobody is meant."""
        if not to:
            return
        addresses = _addresses(to, "daddr" if direction == EGRESS else "saddr")
        if not rule.ports:
            yield addresses
        for port in rule.ports:
            if direction == EGRESS and isinstance(port.port, str):
                yield from self._named(port, to)
            else:
                yield from (f"{addresses} {match}".strip() for match in _ports(port, pod))

    def _named(self, port: Port, to: Networks) -> Iterator[str]:
        """A port that each target's pod gives its own number."""
        protocol = port.protocol
        name = str(port.port)
        meant = [pod for pod in self._pods.values() if (protocol, name) in pod.ports and _within(pod.address, to)]
        pairs = sorted((IPv4Address(pod.address), pod.ports[protocol, name]) for pod in meant)
        if pairs:
            elements = ", ".join(f"{address} . {number}" for address, number in pairs)
            yield f"ip daddr . {protocol.lower()} dport {{ {elements} }}"


class _Direction:
    """One direction of the pods of a node: the chains that judge it, and which one judges each pod."""

    def __init__(self, name: str, own: Sequence[AttachedPod], chains: Sequence[_Chain | None]) -> None:
        different = sorted({chain for chain in chains if chain}, key=lambda one: (one.policies, one.conditions))
        self._own = own
        self._names = {chain: f"{name}-{number}" for number, chain in enumerate(different)}
        self._of = [self._names[chain] if chain else "" for chain in chains]

    def verdicts(self, free: str) -> list[tuple[AttachedPod, str]]:
        """Each pod with the chain that it goes to, or with `free` when no policy isolates it."""
        return [(one, f"goto {name}" if name else free) for one, name in zip(self._own, self._of, strict=True)]

    def text(self, allowed: str) -> Iterator[str]:
        """Each chain: `allowed` where one of its conditions holds, dropped otherwise."""
        for chain, name in self._names.items():
            yield f"  chain {name} {{"
            yield from ("    " + f"{condition} {allowed}".strip() for condition in chain.conditions)
            yield f'    counter drop comment "{chain.policies}"'
            yield "  }"


def _inet(own: Sequence[AttachedPod], leaving: _Direction, arriving: _Direction) -> Iterator[str]:
    itself = [f"{one.pod.address} . {one.pod.address}" for one in own]
    yield from _elements("set itself", "ipv4_addr . ipv4_addr", itself)
    for name, direction in (("leaving", leaving), ("arriving", arriving)):
        verdicts = [f"{one.pod.address} : {verdict}" for one, verdict in direction.verdicts("return")]
        yield from direction.text("return")
        yield from _elements(f"map {name}", "ipv4_addr : verdict", verdicts)
    # `fib`: a frame for many comes from the same bridge, whose table judges it at each port.
    yield f"""  chain leave {{
    meta nfproto != ipv4 counter drop comment "not IPv4"
    ip saddr vmap @leaving
    counter drop comment "{UNKNOWN}"
  }}
  chain arrive {{
    meta nfproto != ipv4 counter drop comment "not IPv4"
    ip daddr vmap @arriving
    iifname "{BRIDGE}" fib daddr type {{ broadcast, multicast }} return
    counter drop comment "{UNKNOWN}"
  }}
  chain forward {{
    type filter hook forward priority filter; policy accept;
    ct state established,related accept
    ip saddr . ip daddr @itself accept
    iifname "{BRIDGE}" jump leave
    oifname "{BRIDGE}" jump arrive
  }}
  chain input {{
    type filter hook input priority filter; policy accept;
    iifname != "{BRIDGE}" accept
    ct state established,related accept
    jump leave
  }}"""


def _bridge(own: Sequence[AttachedPod], arriving: _Direction) -> Iterator[str]:
    yield from arriving.text("accept")
    yield from _elements("set pods", "ipv4_addr", [one.pod.address for one in own])
    yield from _elements("set senders", "ifname . ipv4_addr", [f'"{one.port}" . {one.pod.address}' for one in own])
    ports = [f'"{one.port}" : {verdict}' for one, verdict in arriving.verdicts("accept")]
    yield from _elements("map ports", "ifname : verdict", ports)
    yield f"""  chain prerouting {{
    type filter hook prerouting priority dstnat; policy accept;
    ether type ip iifname . ip saddr @senders accept
    ether type arp iifname . arp saddr ip @senders accept
    counter drop comment "not under its own address"
  }}
  chain forward {{
    type filter hook forward priority filter; policy accept;
    ether type arp accept
    ip daddr @pods accept
    oifname vmap @ports
    counter drop comment "{UNKNOWN}"
  }}"""


def _replaced(family: str) -> tuple[str, str]:
    """Away with what was there, whether it was or not."""
    return f"table {family} {TABLE}", f"delete table {family} {TABLE}"


def _elements(what: str, kind: str, elements: Sequence[str]) -> Iterator[str]:
    yield f"  {what} {{"
    yield f"    type {kind}"
    yield from [f"    elements = {{ {', '.join(elements)} }}"] if elements else []
    yield "  }"


def _addresses(networks: Networks, word: str) -> str:
    if networks == EVERYBODY:
        return ""
    elements = ", ".join(str(network.network_address if network.prefixlen == 32 else network) for network in networks)
    return f"ip {word} {{ {elements} }}"


def _ports(port: Port, pod: NetworkPeer) -> Iterator[str]:
    """The condition on the target's port; none when the pod has no port of that name."""
    protocol = port.protocol.lower()
    if port.port is None:
        yield f"meta l4proto {protocol}"
        return
    first = pod.ports.get((port.protocol, port.port)) if isinstance(port.port, str) else port.port
    if first is not None:
        yield f"{protocol} dport {first}" + (f"-{port.last}" if port.last not in (None, first) else "")


def _block(block: Block) -> Iterator[IPv4Network]:
    """What is left of a block; the cluster knows no IPv6."""
    if isinstance(block.network, IPv6Network):
        return
    left = [block.network]
    for without in block.without:
        if isinstance(without, IPv4Network):
            left = [part for one in left for part in _excluded(one, without)]
    yield from left


def _excluded(network: IPv4Network, without: IPv4Network) -> Iterable[IPv4Network]:
    if not network.overlaps(without):
        return (network,)
    return () if network.subnet_of(without) else network.address_exclude(without)


def _within(address: str, networks: Networks) -> bool:
    return any(IPv4Address(address) in network for network in networks)


def _names(policies: Sequence[NetworkPolicy]) -> str:
    """The names of the policies that select a pod, for who reads the rules."""
    return f"{policies[0].namespace}: {', '.join(sorted(policy.name for policy in policies))}"[:COMMENT_CHARACTERS_MAX]


def _identity(pod: NetworkPeer) -> tuple[str, str]:
    return pod.address, f"{pod.namespace}/{pod.name}"


def _place(one: AttachedPod) -> tuple[IPv4Address, str]:
    return IPv4Address(one.pod.address), one.port
