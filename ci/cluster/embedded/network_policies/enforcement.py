"""NetworkPolicies in the embedded cluster: rules of nftables in each node's network namespace, which the provider
makes of the cluster's policies.

    <cluster>/network-policies.json   what the process that follows them did last (for `status`)

Before a node starts a pod it has the rules of nobody: no pod reaches anything. A process of the host,
`network-policies`, follows policies, namespaces and pods from then on
(`ci.cluster.embedded.network_policies.controller`).
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ci.cluster.embedded.host import followers
from ci.cluster.embedded.host.processes import Launcher, Process, recorded
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network import host_network
from ci.cluster.embedded.network_policies.nftables_rules import TABLE, Rulebook
from ci.errors import SetUpError
from ci.machine.network_policies import BRIDGED, OFF, ON, VARIABLE, sysctl
from robotkube.foundation.kubernetes.core import network_policies as semantics

PROCESS = "network-policies"
MODULE = "ci.cluster.embedded.network_policies.controller"
WEIGHT = 200  # among the daemons: a new pod waits for it
NODE = ".node"  # what the processes that hold a node's namespaces are named by
REPORT_SECONDS = 10.0  # how often the process says that it is there
SILENT_SECONDS_MAX = 60.0
FILTERING = str(sysctl(BRIDGED))
FOLDER = Path(__file__).parent
# What the rules mean: a cluster that enforces others is another one.
DEFINING = (
    *(FOLDER / f"{name}.py" for name in ("controller", "nftables_rules", "enforcement")),
    FOLDER.parent / "network" / "pod_links.py",
    Path(semantics.__file__),
)


@dataclass(frozen=True)
class PolicyReport:
    """What the controller did last: how many policies are at work on how many nodes, as of when (seconds since
    1970), and what keeps it from reconciling."""

    policies: int
    nodes: int
    at: float
    problem: str = ""

    def write(self, folders: ClusterFolders) -> None:
        """Replace the cluster's report."""
        followers.keep_report(folders, PROCESS, self)


def rules(enforced: str) -> list[str]:
    """What is enforced, as text."""
    return [enforced, *(path.read_text(encoding="utf-8") for path in DEFINING if enforced == ON)]


def followed(folders: ClusterFolders) -> bool:
    """Return whether the cluster was started with policies enforced."""
    return any(process.name == PROCESS for process in recorded(folders))


def close(holder: Process) -> None:
    """Give a node that has no pods yet the rules by which none reaches anything; SetUpError where its machine cannot
    enforce them."""
    if _run(holder, "cat", FILTERING).strip() != "1":
        raise SetUpError(
            f"{holder.name}: {FILTERING} is not 1, so nothing would be enforced between pods of one node: "
            f"run `modprobe br_netfilter`, or start the cluster with {VARIABLE}={OFF}"
        )
    apply(holder, Rulebook([], []).node([]))


def apply(holder: Process, text: str) -> None:
    """Replace a node's rules in one step; SetUpError with what nft says against it."""
    host_network.run([*_inside(holder), "nft", "-f", "-"], text)


def start_controller(launcher: Launcher) -> Process:
    """The controller of policies, namespaces and pods, a process; it is started again when it ends."""
    return followers.start(launcher, PROCESS, MODULE, WEIGHT)


def holders(folders: ClusterFolders) -> dict[str, Process]:
    """The processes that hold the nodes' namespaces, by node."""
    return {process.name.removesuffix(NODE): process for process in recorded(folders, f"*{NODE}") if process.alive()}


def status(folders: ClusterFolders, now: float | None = None) -> str:
    """Return whether policies are enforced, in a sentence for people: asked of each node's rules, not of what was
    wished."""
    nodes = holders(folders)
    without = [name for name, holder in sorted(nodes.items()) if not _has_rules(holder)]
    if not followed(folders):
        return f"network policies: not enforced (the cluster was started with {VARIABLE}={OFF})"
    if without:
        return f"network policies: NOT enforced on {', '.join(without)}: start the cluster anew"
    report = followers.read_report(folders, PROCESS, PolicyReport)
    if report is None or (time.time() if now is None else now) - report.at > SILENT_SECONDS_MAX:
        why = "the process network-policies does not follow"
    else:
        why = report.problem
    if why or report is None:
        log = folders.log / f"{PROCESS}.log"
        return (
            f"network policies: the rules of {len(nodes)} nodes stay as they are, new pods are cut off: {why} ({log})"
        )
    return f"network policies: {report.policies} enforced on {report.nodes} nodes"


def _has_rules(holder: Process) -> bool:
    tables = {line.removeprefix("table ") for line in _run(holder, "nft", "list", "tables").splitlines()}
    return tables >= {f"{family} {TABLE}" for family in ("inet", "bridge")}


def _run(holder: Process, *words: str) -> str:
    """What a program says in the node's network namespace; nothing when it fails."""
    command = [*_inside(holder), *words]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=host_network.TIMEOUT_SECONDS, check=False)
    return answer.stdout


def _inside(holder: Process) -> Sequence[str]:
    return ("nsenter", f"--net=/proc/{holder.pid}/ns/net")
