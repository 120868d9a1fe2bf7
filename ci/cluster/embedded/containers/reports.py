"""Containers in the embedded cluster: a process of the host, `containers`, looks at what every node's runtime runs and
names what nobody of the cluster started (`ci.cluster.embedded.containers.polling`).

    <cluster>/containers.json   what its last look saw (for `status`)

Who starts a container by a machine's own runtime asks neither API server nor kubelet: nothing in the cluster sees it.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from ci.cluster.embedded.host import followers
from ci.cluster.embedded.host.processes import Launcher, Process, recorded
from ci.cluster.embedded.host.records import ClusterFolders

PROCESS = "containers"
MODULE = "ci.cluster.embedded.containers.polling"
REPORT_SECONDS = 10.0  # how often the process says that it is there
SILENT_SECONDS_MAX = 60.0


@dataclass(frozen=True)
class ContainerReport:
    """What a look saw: `strangers` in sentences and why a node was `unseen`, by node; how many nodes were looked at, as
    of when (seconds since 1970), and what keeps the process from writing it to the cluster."""

    nodes: int
    at: float
    strangers: Mapping[str, Sequence[str]] = field(default_factory=dict)
    unseen: Mapping[str, str] = field(default_factory=dict)
    problem: str = ""

    def says(self, other: ContainerReport | None) -> bool:
        """Return whether the other one says the same, at whatever time."""
        return other is not None and {**asdict(self), "at": 0} == {**asdict(other), "at": 0}

    def write(self, folders: ClusterFolders) -> None:
        """Replace the cluster's report."""
        followers.keep_report(folders, PROCESS, self)


def start_polling(launcher: Launcher) -> Process:
    """The process that looks at the nodes' containers; it is started again when it ends."""
    return followers.start(launcher, PROCESS, MODULE)


def status(folders: ClusterFolders, now: float | None = None) -> str:
    """What runs beside the kubelets, for people: a sentence, and a line for each stranger and each node that was not
    seen."""
    report = followers.read_report(folders, PROCESS, ContainerReport)
    log = folders.log / f"{PROCESS}.log"
    if not recorded(folders, PROCESS):
        return "containers: not looked at: the cluster has no process containers; start it anew"
    if report is None or (time.time() if now is None else now) - report.at > SILENT_SECONDS_MAX:
        return f"containers: not looked at: the process containers does not look ({log})"
    return "\n".join([_sentence(report), *_lines(report, log)])


def _sentence(report: ContainerReport) -> str:
    count = sum(map(len, report.strangers.values()))
    if count:
        return f"containers: {count} STARTED BESIDE THE KUBELETS of {report.nodes} nodes"
    return f"containers: none beside the kubelets of {report.nodes} nodes"


def _lines(report: ContainerReport, log: Path) -> list[str]:
    lines = [f"  {text}" for _, texts in sorted(report.strangers.items()) for text in texts]
    lines += [f"  {node} was not looked at: {why}" for node, why in sorted(report.unseen.items())]
    return lines + ([f"  the Inspections do not say what was seen: {report.problem} ({log})"] if report.problem else [])
