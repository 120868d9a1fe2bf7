"""The commands and rules by which a cable gets its conditions. Pure.

The cable of an agent is that of its node, with the ends `eth0` in the node and `<bridge>-<number>` on the machine,
which is a port of the bridge. Pods know nothing of it. In the order of the path, upwards:

    rate           a token bucket (tbf) at eth0, with the queue that a modem has; downwards at the port of the bridge
    delay, jitter  netem at the same places, where the kernel has it; otherwise the machine's end is taken from the
                   bridge, and a relay (`relay.py`) carries its packets to one end of another cable, whose other end is
                   the port of the bridge instead
    loss, holes    nftables where packets come in: at the port of the bridge, downwards at eth0

Before packets are dropped large ones are cut into those that a wire would carry, so each of these is lost by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ci.cluster.embedded.network.addresses import AddressPlan
from ci.cluster_contract.network_conditions import NetworkConditions

NODE_END = "eth0"
NODE_TABLE = "robotkube-network"
BURST_BYTES = 32 * 1024
QUEUE_SECONDS = 1.0  # of a modem at its rate
QUEUE_BYTES_MIN = 256 * 1024
QUEUE_PACKETS = 10_000
UNSHAPED_MBIT = 10_000  # netem keeps the order of packets only together with a rate
WHOLE_SEGMENTS = 65_535
MILLION = 1_000_000
UP, DOWN = "up", "down"
CARRIED, LOST, IN_HOLES = "carried", "lost", "in_holes"  # counters of a direction


@dataclass(frozen=True)
class Wiring:
    """The ends of a node's cable. `relayed`: a relay stands between the machine's end and the bridge."""

    plan: AddressPlan
    index: int
    relayed: bool

    @property
    def cable(self) -> str:
        """The machine's end of the node's cable."""
        return self.plan.link(self.index)

    @property
    def relay_end(self) -> str:
        """The end of the second cable that the relay holds."""
        return f"{self.plan.bridge}-e{self.index}"

    @property
    def port(self) -> str:
        """The port of the bridge."""
        return f"{self.plan.bridge}-f{self.index}" if self.relayed else self.cable

    @property
    def table(self) -> str:
        """The nftables table of the machine for this cable; its name begins as those of all cables of the cluster."""
        return self.cable


def relayed(conditions: NetworkConditions, netem: bool) -> bool:
    """Return whether packets have to be delayed by the relay."""
    return bool(conditions.round_trip_ms) and not netem


def shaping(end: str, mbit: float | None, conditions: NetworkConditions, netem: bool) -> list[str]:
    """The words after `tc` that give an end of a cable rate and delay; none where neither is asked for."""
    words = ["qdisc", "replace", "dev", end, "root", "handle", "1:"]
    if conditions.round_trip_ms and netem:
        delay = [f"{conditions.round_trip_ms / 2:g}ms", f"{conditions.jitter_ms / 2:g}ms"]
        rate = ["rate", f"{mbit or UNSHAPED_MBIT:g}mbit"]
        return [*words, "netem", "limit", str(QUEUE_PACKETS), "delay", *delay, *rate]
    if mbit is None:
        return []
    limit = max(QUEUE_BYTES_MIN, int(mbit * MILLION / 8 * QUEUE_SECONDS))
    return [*words, "tbf", "rate", f"{mbit:g}mbit", "burst", str(BURST_BYTES), "limit", str(limit)]


def prepared(wiring: Wiring) -> Iterator[str]:
    """Commands of `ip` on the machine before the relay begins."""
    if wiring.relayed:
        yield f"link add {wiring.relay_end} type veth peer name {wiring.port}"
        yield f"link set {wiring.relay_end} gso_max_segs 1 up"
        yield f"link set {wiring.port} up"
    yield f"link set {wiring.cable} gso_max_segs 1"


def switched(wiring: Wiring) -> Iterator[str]:
    """Commands of `ip` that put the relay into the path."""
    if wiring.relayed:
        yield f"link set {wiring.cable} nomaster"
        yield f"link set {wiring.port} master {wiring.plan.bridge}"


def restored(wiring: Wiring) -> Iterator[str]:
    """Commands of `ip` that make the machine's part as it was before; the second cable goes with one of its ends."""
    if wiring.relayed:
        yield f"link del {wiring.relay_end}"
        yield f"link set {wiring.cable} master {wiring.plan.bridge}"
    yield f"link set {wiring.cable} gso_max_segs {WHOLE_SEGMENTS}"


def cut(on: bool) -> str:
    """The command of `ip` in the node by which large packets leave in pieces, or whole again."""
    return f"link set {NODE_END} gso_max_segs {1 if on else WHOLE_SEGMENTS}"


def machine_rules(wiring: Wiring, conditions: NetworkConditions) -> str:
    """The machine's table: what comes from the node is judged at the port of the bridge. Between cable and relay end
    the machine itself hears nothing: the relay alone carries packets there."""
    lines = [*_judging(wiring.port, conditions)]
    if wiring.relayed:
        lines += [
            "  chain relay {",
            f'    type filter hook ingress devices = {{ "{wiring.cable}", "{wiring.relay_end}" }} priority 0;'
            " policy drop;",
            "  }",
        ]
    return _table(wiring.table, lines)


def node_rules(conditions: NetworkConditions) -> str:
    """The node's table: what comes to it is judged at its end of the cable."""
    return _table(NODE_TABLE, [*_judging(NODE_END, conditions)])


def hole(table: str, end: str, seconds: float) -> str:
    """What ends the coverage for a time: it comes back by itself."""
    return f'add element netdev {table} holes {{ "{end}" timeout {round(seconds * 1000)}ms }}\n'


def _judging(end: str, conditions: NetworkConditions) -> Iterator[str]:
    yield "  set holes {"
    yield "    type ifname"
    yield "    flags timeout"
    yield "  }"
    yield from (f"  counter {kind} {{ }}" for kind in (CARRIED, LOST, IN_HOLES))
    yield "  chain judge {"
    yield f'    type filter hook ingress device "{end}" priority 0; policy accept;'
    yield f"    counter name {CARRIED}"
    yield f"    iifname @holes counter name {IN_HOLES} drop"
    chance = round(conditions.loss_percent / 100 * MILLION)
    if chance:
        yield f"    numgen random mod {MILLION} < {chance} counter name {LOST} drop"
    yield "  }"


def _table(name: str, lines: list[str]) -> str:
    head = [f"table netdev {name}", f"delete table netdev {name}", f"table netdev {name} {{"]
    return "\n".join([*head, *lines, "}"]) + "\n"


def acting(wiring: Wiring, conditions: NetworkConditions, netem: bool, node: str) -> Iterator[str]:
    """The place in the path at which each condition acts, in words, upwards and downwards."""
    own = f"{NODE_END} of node {node}"
    kind = "netem" if conditions.round_trip_ms and netem else "tbf"
    if conditions.up_mbit:
        yield f"rate up: {kind} at {own}"
    if conditions.down_mbit:
        yield f"rate down: {kind} at {wiring.port}"
    if wiring.relayed:
        yield f"delay: relay of packets between {wiring.cable} and {wiring.relay_end}, half in each direction"
    elif conditions.round_trip_ms:
        yield f"delay: netem at {own} and {wiring.port}, half in each direction"
    if conditions.loss_percent:
        yield f"loss: nftables at {wiring.port} (up) and {own} (down)"
    yield f"holes and counters: nftables at {wiring.port} (up) and {own} (down)"
