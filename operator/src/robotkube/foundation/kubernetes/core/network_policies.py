"""NetworkPolicies: whether one pod may connect to another, as Kubernetes defines it.

A connection is allowed when the source's policies let it out and the target's policies let it in. A pod that no policy
of a direction selects is free in that direction. Not said here: what a node sends to its own pods (always allowed), and
what replies (they belong to their connection). Addresses of an `ipBlock` are compared with those of pods, too, as most
network plug-ins do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from ipaddress import IPv4Network, IPv6Network, ip_address, ip_network
from types import MappingProxyType
from typing import Any

from robotkube.errors import InputError

PORT_MAX = 65535
PROTOCOLS = ("TCP", "UDP", "SCTP")
NONE: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class NetworkPeer:
    """Who connects or is connected to: a pod, or, without a namespace, an address outside of the cluster's pods."""

    name: str
    address: str
    namespace: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    namespace_labels: Mapping[str, str] = field(default_factory=dict)
    ports: Mapping[tuple[str, str], int] = field(default_factory=dict)
    """Ports that have a name: (protocol, name) -> number."""


@dataclass(frozen=True)
class Requirement:
    """One condition on labels; `values` is empty for Exists and DoesNotExist."""

    key: str
    operator: str
    values: frozenset[str] = frozenset()

    def holds(self, labels: Mapping[str, str]) -> bool:
        """Return whether these labels meet it. A missing label meets NotIn, as in Kubernetes."""
        if self.operator == "In":
            return labels.get(self.key) in self.values
        if self.operator == "NotIn":
            return labels.get(self.key) not in self.values
        return (self.key in labels) == (self.operator == "Exists")


Selector = tuple[Requirement, ...]
"""All must hold; an empty one selects everything."""


@dataclass(frozen=True)
class Block:
    """Addresses, and those among them that are not meant."""

    network: IPv4Network | IPv6Network
    without: tuple[IPv4Network | IPv6Network, ...]

    def holds(self, address: str) -> bool:
        """Return whether the address is meant."""
        given = ip_address(address)
        return given in self.network and not any(given in one for one in self.without)


@dataclass(frozen=True)
class Peer:
    """Who is on the other side. Without `namespaces`, `pods` are those of the policy's namespace."""

    pods: Selector | None = None
    namespaces: Selector | None = None
    block: Block | None = None

    def holds(self, namespace: str, other: NetworkPeer) -> bool:
        """Return whether `other` is meant by a policy of this namespace."""
        if self.block is not None:
            return self.block.holds(other.address)
        if not other.namespace or not selects(self.pods or (), other.labels):
            return False
        return (
            other.namespace == namespace
            if self.namespaces is None
            else selects(self.namespaces, other.namespace_labels)
        )


@dataclass(frozen=True)
class Port:
    """Ports of a protocol: all (None), one by number or by the name it has in the pod, or those up to `last`."""

    protocol: str
    port: int | str | None = None
    last: int | None = None

    def holds(self, target: NetworkPeer, protocol: str, port: int) -> bool:
        """Return whether this port of the target is meant."""
        if protocol != self.protocol or self.port is None:
            return protocol == self.protocol
        first = target.ports.get((protocol, self.port)) if isinstance(self.port, str) else self.port
        return first is not None and first <= port <= (self.last or first)


@dataclass(frozen=True)
class PolicyRule:
    """Peers and ports; without peers everybody is meant, without ports every port of every protocol."""

    peers: tuple[Peer, ...]
    ports: tuple[Port, ...]


@dataclass(frozen=True)
class NetworkPolicy:
    """One NetworkPolicy. A direction that it does not speak about is None; one without rules denies everything."""

    namespace: str
    name: str
    pods: Selector
    ingress: tuple[PolicyRule, ...] | None
    egress: tuple[PolicyRule, ...] | None

    def selects(self, pod: NetworkPeer) -> bool:
        """Return whether it is about this pod."""
        return pod.namespace == self.namespace and selects(self.pods, pod.labels)


@dataclass(frozen=True)
class Verdict:
    """A judgement of a connection: that it may be made or not, and which policies said so for either side."""

    allowed: bool
    reason: str


def may_connect(
    policies: Sequence[NetworkPolicy], source: NetworkPeer, target: NetworkPeer, protocol: str, port: int
) -> Verdict:
    """Return whether `source` may connect to this port of `target`. A pod may always connect to itself."""
    if source.namespace and (source.namespace, source.name) == (target.namespace, target.name):
        return Verdict(True, f"{source.namespace}/{source.name} is itself")
    out = _direction(policies, source, target, "egress", (target, protocol, port))
    into = _direction(policies, target, source, "ingress", (target, protocol, port))
    return Verdict(out.allowed and into.allowed, f"{out.reason}; {into.reason}")


def _direction(
    policies: Sequence[NetworkPolicy],
    own: NetworkPeer,
    other: NetworkPeer,
    direction: str,
    to: tuple[NetworkPeer, str, int],
) -> Verdict:
    selecting = [one for one in policies if getattr(one, direction) is not None and one.selects(own)]
    if not own.namespace or not selecting:
        return Verdict(True, f"{direction} of {own.namespace or 'outside'}/{own.name}: no policy")
    for policy in selecting:
        for number, rule in enumerate(getattr(policy, direction)):
            if _applies(rule, policy.namespace, other, to):
                return Verdict(True, f"{direction}: {policy.namespace}/{policy.name} rule {number}")
    names = ", ".join(f"{one.namespace}/{one.name}" for one in selecting)
    return Verdict(False, f"{direction} of {own.namespace}/{own.name}: none of {names} allows it")


def _applies(rule: PolicyRule, namespace: str, other: NetworkPeer, to: tuple[NetworkPeer, str, int]) -> bool:
    peers = not rule.peers or any(peer.holds(namespace, other) for peer in rule.peers)
    return peers and (not rule.ports or any(port.holds(*to) for port in rule.ports))


def selects(selector: Selector, labels: Mapping[str, str]) -> bool:
    """Return whether these labels meet every condition."""
    return all(requirement.holds(labels) for requirement in selector)


def read_policy(document: Mapping[str, Any]) -> NetworkPolicy:
    """The policy of a Kubernetes object. InputError names policy, key and fix for what is not understood: a rule that
    was read wrongly would let in whom nobody meant."""
    metadata = document.get("metadata", {})
    where = f"NetworkPolicy {metadata.get('namespace', '')}/{metadata.get('name', '')}"
    spec = _known(document.get("spec"), f"{where}: spec", "podSelector", "policyTypes", "ingress", "egress")
    types = spec.get("policyTypes") or ["Ingress", *(["Egress"] if spec.get("egress") else [])]
    if not set(types) <= {"Ingress", "Egress"}:
        raise InputError(f"{where}: spec.policyTypes: {types} must name Ingress, Egress or both")
    return NetworkPolicy(
        namespace=str(metadata.get("namespace", "")),
        name=str(metadata.get("name", "")),
        pods=read_selector(spec.get("podSelector") or {}, f"{where}: spec.podSelector"),
        ingress=_rules(spec, where, "ingress", "from") if "Ingress" in types else None,
        egress=_rules(spec, where, "egress", "to") if "Egress" in types else None,
    )


def _known(value: Any, where: str, *keys: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: must be a mapping with {', '.join(keys)}")
    unknown = sorted(set(value) - set(keys))
    if unknown:
        raise InputError(f"{where}.{unknown[0]}: is unknown; known keys are {', '.join(keys)}")
    return value


def _rules(spec: Mapping[str, Any], where: str, direction: str, key: str) -> tuple[PolicyRule, ...]:
    rules = []
    for number, stated in enumerate(spec.get(direction) or ()):
        at = f"{where}: spec.{direction}[{number}]"
        rule = _known(stated, at, key, "ports")
        peers = tuple(_peer(peer, f"{at}.{key}[{i}]") for i, peer in enumerate(rule.get(key) or ()))
        ports = tuple(_port(port, f"{at}.ports[{i}]") for i, port in enumerate(rule.get("ports") or ()))
        rules.append(PolicyRule(peers, ports))
    return tuple(rules)


def _peer(stated: Any, where: str) -> Peer:
    peer = _known(stated, where, "podSelector", "namespaceSelector", "ipBlock")
    if not peer or ("ipBlock" in peer and len(peer) > 1):
        raise InputError(f"{where}: must be an ipBlock alone, or a podSelector, a namespaceSelector or both")
    if "ipBlock" in peer:
        return Peer(block=_block(peer["ipBlock"], f"{where}.ipBlock"))
    pods, namespaces = (
        read_selector(peer[key], f"{where}.{key}") if key in peer else None
        for key in ("podSelector", "namespaceSelector")
    )
    return Peer(pods, namespaces)


def _block(stated: Any, where: str) -> Block:
    block = _known(stated, where, "cidr", "except")
    try:
        return Block(ip_network(block.get("cidr", "")), tuple(ip_network(one) for one in block.get("except") or ()))
    except ValueError as error:
        raise InputError(f"{where}: {error}; give ranges such as 10.0.0.0/8") from error


def _port(stated: Any, where: str) -> Port:
    port = _known(stated, where, "protocol", "port", "endPort")
    protocol = port.get("protocol") or "TCP"
    first = port.get("port")
    last = port.get("endPort")
    if protocol not in PROTOCOLS:
        raise InputError(f"{where}.protocol: {protocol!r} must be one of {', '.join(PROTOCOLS)}")
    if isinstance(first, int) and not 0 < first <= PORT_MAX:
        raise InputError(f"{where}.port: {first} must be 1 to {PORT_MAX}")
    if last is not None and (not isinstance(first, int) or not first <= last <= PORT_MAX):
        raise InputError(f"{where}.endPort: {last} needs a port by number that is not above it")
    return Port(protocol, first, last)


def read_selector(stated: Any, where: str) -> Selector:
    """The conditions of a selector in Kubernetes form; InputError names key and fix for what is not understood."""
    selector = _known(stated, where, "matchLabels", "matchExpressions")
    labels = (selector.get("matchLabels") or NONE).items()
    requirements = [Requirement(key, "In", frozenset([value])) for key, value in labels]
    for number, one in enumerate(selector.get("matchExpressions") or ()):
        at = f"{where}.matchExpressions[{number}]"
        expression = _known(one, at, "key", "operator", "values")
        operator = expression.get("operator")
        values = frozenset(expression.get("values") or ())
        if operator not in ("In", "NotIn", "Exists", "DoesNotExist"):
            raise InputError(f"{at}.operator: {operator!r} must be In, NotIn, Exists or DoesNotExist")
        if bool(values) != (operator in ("In", "NotIn")):
            raise InputError(f"{at}.values: In and NotIn need some, Exists and DoesNotExist take none")
        requirements.append(Requirement(str(expression.get("key")), operator, values))
    return tuple(requirements)
