"""Gives the cables of agents their conditions, opens holes, counts, and takes all of it away.

    <cluster>/network-conditions.json     which nodes' cables have conditions: written before the first is touched
    <cluster>/network-relay.settings.json what the relay carries

What a process that was killed has left is taken away by the next `clear`, by the next `up` and by `down`.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ci.cluster.embedded.emulation import probing, relay, rules
from ci.cluster.embedded.emulation.probing import Ends
from ci.cluster.embedded.emulation.rules import DOWN, UP, Wiring
from ci.cluster.embedded.host import followers
from ci.cluster.embedded.host.processes import Launcher, Process, recorded, wait_until
from ci.cluster.embedded.host.records import ClusterFolders, write_atomically
from ci.cluster.embedded.network import host_network
from ci.cluster.embedded.network.addresses import AddressPlan
from ci.cluster.embedded.network.host_network import run
from ci.cluster.embedded.network_policies import enforcement
from ci.cluster_contract.network_conditions import Measured, NetworkConditions, Traffic
from ci.cluster_contract.provider import NodeState
from ci.errors import SetUpError

RECORD = "network-conditions"
PLATFORM = "platform"
RELAY_SECONDS_MAX = 15.0
RELAY_WEIGHT = 800  # among the daemons: who waits for it would see another delay
TRIALS = {
    "tbf": ("tc", "qdisc", "add", "dev", "lo", "root", "tbf", "rate", "1mbit", "burst", "32768", "limit", "65536"),
    "netem": ("tc", "qdisc", "add", "dev", "lo", "root", "netem", "delay", "1ms"),
}
NUMGEN = "table netdev t { chain c { numgen random mod 100 < 1 drop; }; }"


@dataclass(frozen=True)
class EmulatedCable:
    """The cable of an agent's node, with its conditions."""

    node: str
    conditions: NetworkConditions
    wiring: Wiring
    netem: bool

    @property
    def acts(self) -> tuple[str, ...]:
        """The place in the path at which each condition acts, in words."""
        return tuple(rules.acting(self.wiring, self.conditions, self.netem, self.node))


class NetworkEmulation:
    """The cables of a cluster's nodes. `nodes` gives the nodes as they are now."""

    def __init__(self, plan: AddressPlan, launcher: Launcher, nodes: Callable[[], Sequence[NodeState]]) -> None:
        self._plan = plan
        self._launcher = launcher
        self._folders: ClusterFolders = launcher.folders
        self._nodes = nodes
        self._cables: dict[str, EmulatedCable] = {}

    def check(self, wanted: Mapping[str, NetworkConditions]) -> None:
        """See NetworkEmulator.check; nothing is changed."""
        self._placed(wanted)
        unmet = problems(wanted, can)
        if unmet:
            raise SetUpError("\n".join(unmet))

    def apply(self, wanted: Mapping[str, NetworkConditions]) -> Mapping[str, tuple[str, ...]]:
        """See NetworkEmulator.apply."""
        self.clear()
        self.check(wanted)
        placed = self._placed(wanted)
        netem = can("netem")
        cables = {
            agent: EmulatedCable(
                placed[agent].name,
                conditions,
                Wiring(self._plan, self._plan.index(placed[agent].address), rules.relayed(conditions, netem)),
                netem,
            )
            for agent, conditions in wanted.items()
        }
        record = [{"node": cable.node, "index": cable.wiring.index} for cable in cables.values()]
        write_atomically(self._folders.base / f"{RECORD}.json", json.dumps(record))
        try:
            self._make(list(cables.values()))
        except BaseException:
            self.clear()
            raise
        self._cables = cables
        return {agent: cable.acts for agent, cable in cables.items()}

    def probe(self) -> Mapping[str, Measured]:
        """See NetworkEmulator.probe: against the node where the platform runs."""
        nodes = self._nodes()
        far = next((node for node in nodes if node.role == PLATFORM), None)
        if far is None:
            raise SetUpError(f"cluster {self._folders.name} has no node of role {PLATFORM} to probe cables against")
        holders = enforcement.holders(self._folders)
        addresses = {node.name: node.address for node in nodes}
        ends = {
            agent: Ends(
                _namespace(holders[cable.node]), addresses[cable.node], _namespace(holders[far.name]), far.address
            )
            for agent, cable in self._cables.items()
        }
        return probing.probe(ends, {agent: cable.conditions for agent, cable in self._cables.items()})

    def cut(self, agent: str, seconds: float) -> None:
        """See NetworkEmulator.cut."""
        cable = self._cable(agent)
        run(["nft", "-f", "-"], rules.hole(cable.wiring.table, cable.wiring.port, seconds))
        run([*self._inside(cable.node), "nft", "-f", "-"], rules.hole(rules.NODE_TABLE, rules.NODE_END, seconds))

    def traffic(self, agent: str) -> Mapping[str, Traffic]:
        """See NetworkEmulator.traffic."""
        cable = self._cable(agent)
        own = self._inside(cable.node)
        up = _counted(run(["nft", "-j", "list", "counters", "table", "netdev", cable.wiring.table]))
        down = _counted(run([*own, "nft", "-j", "list", "counters", "table", "netdev", rules.NODE_TABLE]))
        up_queue = _queue_full(run([*own, "tc", "-s", "-j", "qdisc", "show", "dev", rules.NODE_END]))
        down_queue = _queue_full(run(["tc", "-s", "-j", "qdisc", "show", "dev", cable.wiring.port]))
        return {UP: Traffic(*up, up_queue), DOWN: Traffic(*down, down_queue)}

    def relay_dropped(self) -> int:
        """See NetworkEmulator.relay_dropped: those for which the relay had no place or no time."""
        report = followers.read_report(self._folders, relay.NAME, relay.RelayReport)
        return report.dropped if report else 0

    def clear(self) -> None:
        """See NetworkEmulator.clear."""
        clear(self._plan, self._folders)
        self._cables = {}

    def _placed(self, wanted: Mapping[str, NetworkConditions]) -> dict[str, NodeState]:
        """The node of each agent."""
        nodes = self._nodes()
        placed = {}
        for agent in wanted:
            own = [node for node in nodes if node.agent == agent]
            if len(own) != 1:
                raise SetUpError(
                    f"cluster {self._folders.name} has {len(own)} nodes of agent {agent}, and only the cable of an "
                    "agent with one node can have conditions: name another in `network`, or give it one node"
                )
            placed[agent] = own[0]
        return placed

    def _make(self, cables: Sequence[EmulatedCable]) -> None:
        for cable in cables:
            wiring = cable.wiring
            run(["ip", "-batch", "-"], "\n".join(rules.prepared(wiring)))
        if any(cable.wiring.relayed for cable in cables):
            self._start_relay(cables)
        for cable in cables:
            self._make_one(cable)

    def _make_one(self, cable: EmulatedCable) -> None:
        wiring = cable.wiring
        conditions = cable.conditions
        own = self._inside(cable.node)
        run(["nft", "-f", "-"], rules.machine_rules(wiring, conditions))
        run(["ip", "-batch", "-"], "\n".join(rules.switched(wiring)))
        run([*own, "ip", "-batch", "-"], rules.cut(on=True))
        run([*own, "nft", "-f", "-"], rules.node_rules(conditions))
        for place, name, mbit in ((own, rules.NODE_END, conditions.up_mbit), ((), wiring.port, conditions.down_mbit)):
            words = rules.shaping(name, mbit, conditions, cable.netem)
            if words:
                run([*place, "tc", *words])

    def _start_relay(self, cables: Sequence[EmulatedCable]) -> None:
        carried = [
            {
                "near": cable.wiring.cable,
                "far": cable.wiring.relay_end,
                "delay_ms": cable.conditions.round_trip_ms / 2,
                "jitter_ms": cable.conditions.jitter_ms / 2,
            }
            for cable in cables
            if cable.wiring.relayed
        ]
        write_atomically(_settings(self._folders), json.dumps({"cables": carried}))
        command = [sys.executable, "-m", relay.MODULE, "--name", self._folders.name]
        process = self._launcher.start(relay.NAME, command, (), followers.environment(), RELAY_WEIGHT)

        def runs() -> bool:
            return followers.read_report(self._folders, relay.NAME, relay.RelayReport) is not None

        wait_until(runs, "the relay of packets", RELAY_SECONDS_MAX, [process])

    def _inside(self, node: str) -> tuple[str, ...]:
        return _entering(enforcement.holders(self._folders)[node])

    def _cable(self, agent: str) -> EmulatedCable:
        if agent not in self._cables:
            raise SetUpError(f"the cable of {agent} has no conditions; it can have a hole only together with them")
        return self._cables[agent]


def clear(plan: AddressPlan, folders: ClusterFolders) -> None:
    """Take every condition of a cluster's cables away, whoever has made them. The relay goes first: what it still holds
    is sent again by its senders."""
    record = folders.base / f"{RECORD}.json"
    try:
        known = json.loads(record.read_text(encoding="utf-8"))
    except FileNotFoundError:
        known = []
    _stop_relay(folders)
    holders = enforcement.holders(folders)
    for entry in known:
        if _clear_machine(plan, entry["index"]) and entry["node"] in holders:
            _clear_node(_entering(holders[entry["node"]]))
    record.unlink(missing_ok=True)


def _clear_machine(plan: AddressPlan, index: int) -> bool:
    """Return whether the node's cable is there at all; with it everything else goes."""
    there = host_network.links(plan)
    wiring = Wiring(plan, index, relayed=Wiring(plan, index, True).relay_end in there)
    if wiring.cable not in there:
        return False
    run(["ip", "-batch", "-"], "\n".join(rules.restored(wiring)))
    _tried("tc", "qdisc", "del", "dev", wiring.cable, "root")
    _tried("nft", "delete", "table", "netdev", wiring.table)
    return True


def _clear_node(own: Sequence[str]) -> None:
    run([*own, "ip", "-batch", "-"], rules.cut(on=False))
    _tried(*own, "tc", "qdisc", "del", "dev", rules.NODE_END, "root")
    _tried(*own, "nft", "delete", "table", "netdev", rules.NODE_TABLE)


def _stop_relay(folders: ClusterFolders) -> None:
    for process in recorded(folders, relay.NAME):
        if process.alive():
            os.kill(process.pid, signal.SIGKILL)
        (folders.processes / f"{relay.NAME}.json").unlink()
    for left in (_settings(folders), folders.base / f"{relay.NAME}.json"):
        left.unlink(missing_ok=True)


def _settings(folders: ClusterFolders) -> Path:
    return folders.base / f"{relay.NAME}.settings.json"


def _namespace(holder: Process) -> Path:
    return Path(f"/proc/{holder.pid}/ns/net")


def _entering(holder: Process) -> tuple[str, ...]:
    return ("nsenter", f"--net={_namespace(holder)}")


def _tried(*command: str) -> None:
    """Run what fails where there is nothing to take away."""
    subprocess.run(command, capture_output=True, timeout=host_network.TIMEOUT_SECONDS, check=False)


def problems(wanted: Mapping[str, NetworkConditions], able: Callable[[str], bool]) -> list[str]:
    """What this machine cannot do of what is asked, in sentences with the way out. `able`: whether it has tbf, netem
    or numgen."""
    rated = sorted(agent for agent, one in wanted.items() if one.up_mbit or one.down_mbit)
    lossy = sorted(agent for agent, one in wanted.items() if one.loss_percent)
    delayed = any(one.round_trip_ms for one in wanted.values())
    lacking = []
    if rated and not able("tbf") and not (delayed and able("netem")):
        lacking.append(_lacking("tbf", "sch_tbf", "rate", rated, "up_mbit and down_mbit"))
    if lossy and not able("numgen"):
        lacking.append(_lacking("numgen of nftables", "nft_numgen", "loss", lossy, "loss_percent"))
    return lacking


def _lacking(what: str, module: str, condition: str, agents: Sequence[str], keys: str) -> str:
    return (
        f"this machine's kernel has no {what}, so the cable of {', '.join(agents)} cannot have its {condition}: load "
        f"the module {module}, or leave {keys} out of `network`"
    )


def can(what: str) -> bool:
    """Return whether the kernel has tbf, netem or numgen: tried in a network namespace that ends with the trial."""
    trial = ("nft", "-f", "-") if what == "numgen" else TRIALS[what]
    done = subprocess.run(
        ["unshare", "--net", *trial],
        input=NUMGEN,
        capture_output=True,
        text=True,
        timeout=host_network.TIMEOUT_SECONDS,
        check=False,
    )
    return done.returncode == 0


def _counted(text: str) -> tuple[int, int, int]:
    """The counters of a table: packets, those that were lost, those in holes."""
    counters = [entry["counter"] for entry in json.loads(text)["nftables"] if "counter" in entry]
    packets = {counter["name"]: int(counter["packets"]) for counter in counters}
    return packets[rules.CARRIED], packets[rules.LOST], packets[rules.IN_HOLES]


def _queue_full(text: str) -> int:
    """The packets for which a cable's queue had no place."""
    return sum(int(load.get("drops", 0)) for load in json.loads(text) if load["kind"] in ("tbf", "netem"))
