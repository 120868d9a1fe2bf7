"""What the text of nftables rules means, for the words that `network_rules` writes: read again, and asked about single
packets. That the kernel means the same, `test_network_rules_nft` shows."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from ipaddress import ip_address, ip_network

from robotkube.foundation.kubernetes.core.network_policies import NetworkPeer

BRIDGE, CABLE = "cni0", "eth0"  # of a node: to its pods, to the other nodes
ACCEPT, DROP, RETURN = "accept", "drop", "return"
TABLE = re.compile(r"^table (inet|bridge) \S+ \{\n(.*?)^\}", re.MULTILINE | re.DOTALL)
BLOCK = re.compile(r"^  (set|map|chain) (\S+) \{\n(.*?)^  \}", re.MULTILINE | re.DOTALL)
ELEMENTS = re.compile(r"elements = \{ (.*) \}")
HOOK = re.compile(r"type filter hook (\w+) priority \w+; policy accept;")


@dataclass(frozen=True)
class Packet:
    """The first packet of a connection, as one hook sees it."""

    source: str
    target: str
    protocol: str
    port: int
    came_by: str
    goes_by: str = ""
    kind: str = "ip"
    to_many: bool = False


@dataclass
class Table:
    """One table: what its sets and maps hold, and the lines of its chains."""

    sets: dict[str, list[str]] = field(default_factory=dict)
    maps: dict[str, dict[str, str]] = field(default_factory=dict)
    chains: dict[str, list[str]] = field(default_factory=dict)
    hooks: dict[str, str] = field(default_factory=dict)

    def judge(self, hook: str, packet: Packet) -> bool:
        """Return whether a packet passes a hook."""
        return self._run(self.hooks[hook], packet) != DROP

    def _run(self, chain: str, packet: Packet) -> str:
        for line in self.chains[chain]:
            verdict = self._line(line, packet)
            if verdict.startswith("jump "):
                verdict = self._run(verdict.split()[1], packet)
                if verdict == RETURN:
                    continue
            elif verdict.startswith("goto "):
                return self._run(verdict.split()[1], packet)
            if verdict:
                return verdict
        return ACCEPT if chain in self.hooks.values() else RETURN

    def _line(self, line: str, packet: Packet) -> str:
        """The verdict of a line; empty when it says nothing of this packet."""
        rest = line
        while rest:
            for pattern, holds in CONDITIONS:
                if match := pattern.match(rest):
                    answer = holds(self, packet, match)
                    if answer is False:
                        return ""
                    if isinstance(answer, str):
                        return answer
                    rest = rest[match.end() :].strip()
                    break
            else:
                raise AssertionError(f"not understood: {rest!r} of {line!r}")
        return ""


Condition = Callable[[Table, Packet, re.Match[str]], bool | str]


def _among(address: str, elements: str) -> bool:
    return any(ip_address(address) in ip_network(one) for one in elements.split(", "))


def _ways(packet: Packet) -> Mapping[str, str]:
    return {"iifname": packet.came_by, "oifname": packet.goes_by, "saddr": packet.source, "daddr": packet.target}


def _mapped(table: Table, packet: Packet, found: re.Match[str]) -> bool | str:
    key = _ways(packet)[found[1]]
    return table.maps[found[2]].get(f'"{key}"' if found[1].endswith("name") else key, True)


_WORDS: tuple[tuple[str, Condition], ...] = (
    (r"ct state established,related", lambda *_: False),
    (r"meta nfproto != ipv4", lambda _, packet, __: packet.kind == "ip6"),
    (r"ether type arp iifname \. arp saddr ip @(\S+)", lambda *_: False),
    (
        r"ether type ip iifname \. ip saddr @(\S+)",
        lambda t, p, found: p.kind == "ip" and f'"{p.came_by}" . {p.source}' in t.sets[found[1]],
    ),
    (r"ether type arp", lambda _, packet, __: packet.kind == "arp"),
    (r"fib daddr type \{ broadcast, multicast \}", lambda _, packet, __: packet.to_many),
    (r"ip saddr \. ip daddr @(\S+)", lambda t, p, found: f"{p.source} . {p.target}" in t.sets[found[1]]),
    (
        r"ip daddr \. (\w+) dport \{ (.*?) \}",
        lambda _, p, found: p.protocol == found[1] and f"{p.target} . {p.port}" in found[2].split(", "),
    ),
    (r"ip daddr @(\S+)", lambda t, packet, found: packet.kind == "ip" and packet.target in t.sets[found[1]]),
    (r"(?:ip )?(saddr|daddr|iifname|oifname) vmap @(\S+)", _mapped),
    (r"ip (saddr|daddr) \{ (.*?) \}", lambda _, packet, found: _among(_ways(packet)[found[1]], found[2])),
    (r'(iifname|oifname) != "(\S+)"', lambda _, packet, found: _ways(packet)[found[1]] != found[2]),
    (r'(iifname|oifname) "(\S+)"', lambda _, packet, found: _ways(packet)[found[1]] == found[2]),
    (r"meta l4proto (\w+)", lambda _, packet, found: packet.protocol == found[1]),
    (
        r"(tcp|udp|sctp) dport (\d+)(?:-(\d+))?",
        lambda _, p, found: p.protocol == found[1] and int(found[2]) <= p.port <= int(found[3] or found[2]),
    ),
    (r'counter|comment "[^"]*"', lambda *_: True),
    (r"(accept|drop|return|jump \S+|goto \S+)", lambda _, __, found: found[1]),
)
CONDITIONS = tuple((re.compile(words), holds) for words, holds in _WORDS)


def read(text: str) -> dict[str, Table]:
    """The tables of a node by family."""
    tables = {}
    for family, body in TABLE.findall(text):
        tables[family] = table = Table()
        for kind, name, content in BLOCK.findall(body):
            held = ELEMENTS.search(content)
            elements = held[1].split(", ") if held else []
            if kind == "set":
                table.sets[name] = elements
            elif kind == "map":
                table.maps[name] = dict(element.split(" : ") for element in elements)
            else:
                lines = [line.strip() for line in content.splitlines()]
                if hook := HOOK.fullmatch(lines[0]):
                    table.hooks[hook[1]] = name
                    lines = lines[1:]
                table.chains[name] = lines
    assert set(tables) == {"inet", "bridge"}
    return tables


@dataclass(frozen=True)
class PlacedPod:
    """A pod with its node and its port there; somebody outside of the cluster has neither."""

    peer: NetworkPeer
    node: str = ""
    port: str = ""


@dataclass(frozen=True)
class Network:
    """The rules of all nodes."""

    nodes: Mapping[str, Mapping[str, Table]]

    def passes(self, source: PlacedPod, target: PlacedPod, protocol: str, port: int) -> bool:
        """Return whether the first packet of a connection comes from one to the other."""
        packet = Packet(source.peer.address, target.peer.address, protocol.lower(), port, source.port, target.port)
        if source.node and not self.nodes[source.node]["bridge"].judge("prerouting", packet):
            return False
        if source.node == target.node:
            between = self.nodes[source.node]
            routed = replace(packet, came_by=BRIDGE, goes_by=BRIDGE)
            return between["bridge"].judge("forward", packet) and between["inet"].judge("forward", routed)
        out = replace(packet, came_by=BRIDGE, goes_by=CABLE)
        into = replace(packet, came_by=CABLE, goes_by=BRIDGE)
        return (not source.node or self.nodes[source.node]["inet"].judge("forward", out)) and (
            not target.node or self.nodes[target.node]["inet"].judge("forward", into)
        )

    def heard(self, source: PlacedPod, group: str, target: PlacedPod, port: int) -> bool:
        """Return whether a datagram to a group comes to another pod of the node."""
        packet = Packet(source.peer.address, group, "udp", port, source.port, target.port, to_many=True)
        between = self.nodes[source.node]
        routed = replace(packet, came_by=BRIDGE, goes_by=BRIDGE)
        return (
            between["bridge"].judge("prerouting", packet)
            and between["bridge"].judge("forward", packet)
            and between["inet"].judge("forward", routed)
        )

    def ends_at_the_node(self, source: PlacedPod, address: str, port: int) -> bool:
        """Return whether a pod reaches an address of its own node."""
        packet = Packet(source.peer.address, address, "tcp", port, source.port)
        between = self.nodes[source.node]
        return between["bridge"].judge("prerouting", packet) and between["inet"].judge(
            "input", replace(packet, came_by=BRIDGE)
        )
