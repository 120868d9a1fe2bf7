"""The machine's part of a cluster's network: a bridge, a cable to every node, routes, a filter, system settings.

Pods reach pods, Services, the name service and the API server, and nothing else: a node has no default route, and the
filter drops what comes over the bridge for any other port of the host.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

from ci.cluster.embedded.host.records import Record
from ci.cluster.embedded.network.addresses import AddressPlan
from ci.errors import SetUpError
from ci.machine.network_policies import BRIDGE_MODULE, BRIDGED, sysctl

TIMEOUT_SECONDS = 30
API_SERVER_PORT = 6443
NAME_PORT = 53
SOCKET_BUFFER_BYTES = 4 * 2**20  # a point cloud is one burst of datagrams

# Lower bounds, except where `exactly` says otherwise.
AT_LEAST = {
    "fs.inotify.max_user_instances": 8192,  # the twelfth kubelet dies with the default
    "fs.inotify.max_user_watches": 1048576,
    "net.core.rmem_max": SOCKET_BUFFER_BYTES,
    "net.core.rmem_default": SOCKET_BUFFER_BYTES,
    "net.core.wmem_max": SOCKET_BUFFER_BYTES,
}
EXACTLY = {BRIDGED: 0}  # nodes filter in their own namespaces


def run(command: Sequence[str], text: str | None = None) -> str:
    """Run a network command; its standard output; raises SetUpError with its message."""
    if shutil.which(command[0]) is None:
        raise SetUpError(f"{command[0]} is missing; install the cluster's Debian packages: make cluster does it")
    result = subprocess.run(command, input=text, capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=False)
    if result.returncode != 0:
        raise SetUpError(f"{' '.join(command)} failed: {result.stderr.strip()[-500:]}")
    return result.stdout


def set_sysctls(record: Record, record_file: Path) -> None:
    """Raise the bounds of the machine; the former values are recorded first, and once."""
    if not sysctl(BRIDGED).exists() and shutil.which("modprobe"):
        subprocess.run(["modprobe", "--quiet", BRIDGE_MODULE], check=False, timeout=TIMEOUT_SECONDS)
    wanted: dict[str, str] = {}
    for name, value in (AT_LEAST | EXACTLY).items():
        path = sysctl(name)
        if not path.exists():
            continue
        present = int(path.read_text())
        if present < value or (name in EXACTLY and present != value):
            wanted[name] = str(value)
            record.sysctls.setdefault(name, str(present))
    record.write(record_file)
    for name, text in wanted.items():
        sysctl(name).write_text(text)


def restore_sysctls(record: Record) -> None:
    """Put the former values back."""
    for name, value in record.sysctls.items():
        sysctl(name).write_text(value)


def create_bridge(plan: AddressPlan) -> None:
    """The bridge with the gateway's address, and the filter for what comes over it."""
    commands = [
        f"link add {plan.bridge} address {plan.hardware_address} type bridge",
        f"addr add {plan.gateway}/{plan.nodes.prefixlen} dev {plan.bridge}",
        f"link set {plan.bridge} up",
    ]
    run(["ip", "-batch", "-"], "\n".join(commands))
    run(["nft", "-f", "-"], filter_rules(plan))


def filter_rules(plan: AddressPlan) -> str:
    """The nftables table of the cluster: names and the API over the bridge, no other port, no forwarding out or in."""
    bridge = plan.bridge
    return f"""
table inet {bridge} {{
  chain input {{
    type filter hook input priority filter; policy accept;
    iifname != "{bridge}" accept
    ct state established,related accept
    meta l4proto icmp accept
    udp dport {NAME_PORT} accept
    tcp dport {{ {NAME_PORT}, {API_SERVER_PORT} }} accept
    drop
  }}
  chain forward {{
    type filter hook forward priority filter; policy accept;
    iifname "{bridge}" drop
    oifname "{bridge}" drop
  }}
}}
"""


def connect(plan: AddressPlan, pids: Sequence[int]) -> None:
    """A cable from the bridge into the network namespace of each process of `pids` (one per node, in order)."""
    cables = [command for index, pid in enumerate(pids) for command in _cable(plan, index, pid)]
    run(["ip", "-batch", "-"], "\n".join(cables))
    for index, pid in enumerate(pids):
        run_inside(pid, _inside(plan, index, len(pids)))
    # A Service's address means something in a node's namespace only: the first node (platform-0) stands for all.
    routes = [_way(plan, index) for index in range(len(pids))]
    routes.append(f"route add {plan.services} via {plan.node(0)}")
    run(["ip", "-batch", "-"], "\n".join(routes))


def join(plan: AddressPlan, index: int, pid: int, others: Sequence[int]) -> None:
    """The cable of one more node, number `index`, held by process `pid`; and the way to its pods for the host and for
    the nodes that are there (`others`: the processes that hold them)."""
    run(["ip", "-batch", "-"], "\n".join([*_cable(plan, index, pid), _way(plan, index)]))
    run_inside(pid, _inside(plan, index, index + 1))
    for other in others:
        run_inside(other, [_way(plan, index)])


def run_inside(pid: int, commands: Iterable[str]) -> None:
    """Commands of `ip` in a node's network namespace."""
    run(["nsenter", f"--net=/proc/{pid}/ns/net", "ip", "-batch", "-"], "\n".join(commands))


def _cable(plan: AddressPlan, index: int, pid: int) -> Iterable[str]:
    link = plan.link(index)
    yield f"link add {link} type veth peer name eth0 netns {pid}"
    yield f"link set {link} master {plan.bridge} up"


def _way(plan: AddressPlan, index: int) -> str:
    return f"route add {plan.pod_subnet(index)} via {plan.node(index)}"


def _inside(plan: AddressPlan, index: int, count: int) -> Iterable[str]:
    yield f"addr add {plan.node(index)}/{plan.nodes.prefixlen} dev eth0"
    yield "link set eth0 up"
    for other in range(count):
        if other != index:
            yield _way(plan, other)
    # Without it kube-proxy's rules do not see packets to Services: they are dropped before, having no route.
    yield f"route add {plan.services} via {plan.gateway}"


def remove(plan: AddressPlan) -> None:
    """Remove bridge, cables, filter and rules of links, whatever of it is there."""
    for link in links(plan):
        subprocess.run(["ip", "link", "delete", link], capture_output=True, timeout=TIMEOUT_SECONDS, check=False)
    for table in tables(plan):
        run(["nft", "delete", *table.split()])


def links(plan: AddressPlan) -> tuple[str, ...]:
    """Names of the bridge and the cables that are there."""
    if shutil.which("ip") is None:
        return ()  # without it no cluster can have been started
    names = (entry["ifname"] for entry in json.loads(run(["ip", "-json", "link", "show"]) or "[]"))
    return tuple(name for name in names if _is_of(plan, name))


def tables(plan: AddressPlan) -> tuple[str, ...]:
    """The cluster's nftables tables that are there."""
    if shutil.which("nft") is None:
        return ()
    listed = run(["nft", "list", "tables"]).splitlines()
    return tuple(line for line in listed if _is_of(plan, line.split()[-1]))


def _is_of(plan: AddressPlan, name: str) -> bool:
    return name == plan.bridge or name.startswith(f"{plan.bridge}-")


def routes(plan: AddressPlan) -> tuple[str, ...]:
    """Routes of the host into the cluster that are there."""
    if shutil.which("ip") is None:
        return ()
    listed = run(["ip", "route", "show"]).splitlines()
    return tuple(line.strip() for line in listed if plan.bridge in line.split())
