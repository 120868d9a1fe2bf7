"""`python -m ci.cluster.embedded.containers.polling`: looks at the containers of every node's runtime and names
those that nobody of the cluster started, as Inspection `machine.<node>` with Events and log lines.

A process of the host: it reads the nodes' own files, so who administers the cluster through its API has no way to it.
While the cluster takes no Inspections, or has others than it wrote, it goes on looking, says so once, and `status`
names what it sees.
"""

from __future__ import annotations

import argparse
import logging
import time
from collections.abc import Callable, Iterable
from typing import Protocol

from ci.cluster.embedded.containers.beside_kubelets import NodeContents, Unknown, Watched, message, unknown
from ci.cluster.embedded.containers.node_containers import NodeContainers
from ci.cluster.embedded.containers.reports import PROCESS, REPORT_SECONDS, ContainerReport
from ci.cluster.embedded.host.processes import recorded
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import plan_of
from robotkube.delivery.inspection.adapters.kubernetes_inspections import KubernetesInspections
from robotkube.delivery.inspection.core.strangers import BESIDE_THE_KUBELET, CONTAINER, MACHINE, Look, Stranger
from robotkube.delivery.inspection.loops.reporting import Reporter
from robotkube.delivery.inspection.ports import NotInstalledError
from robotkube.errors import InputError, RobotKubeError, UnavailableError
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer

LOOK_SECONDS = 1.0  # between looks; with GRACE_SECONDS a stranger is named within 15 s
ATTEND_SECONDS = 5.0  # how often it is read what others wrote into what was reported
AGAIN_SECONDS = 5.0  # after the cluster took no report
API_SECONDS_MAX = 5.0  # that a request may keep it from looking
NAMESPACE = "robotkube"  # the platform's
API_PORT = 6443  # of every cluster here
CONTAINERD = ".containerd"  # what the nodes' runtimes are named by

log = logging.getLogger("robotkube.containers")


class Nodes(Protocol):
    """The nodes of a cluster."""

    def names(self) -> Iterable[str]:
        """The nodes that are there now."""

    def read(self, name: str) -> NodeContents:
        """What runs on one of them; UnavailableError or OSError when that cannot be said."""


class ContainersOfNodes:
    """The nodes of a cluster on this machine."""

    def __init__(self, folders: ClusterFolders) -> None:
        self._folders = folders
        self._nodes: dict[str, NodeContainers] = {}
        self._alive: dict[str, bool] = {}

    def names(self) -> Iterable[str]:
        """The nodes that are there now, by their records."""
        runtimes = recorded(self._folders, f"*{CONTAINERD}")
        self._alive = {runtime.name.removesuffix(CONTAINERD): runtime.alive() for runtime in runtimes}
        return sorted(self._alive)

    def read(self, name: str) -> NodeContents:
        """What runs on it. While its runtime does not, nobody keeps its files: they say nothing."""
        if not self._alive[name]:
            raise UnavailableError("its containerd does not run; start the node again")
        if name not in self._nodes:
            self._nodes[name] = NodeContainers(self._folders.node(name))
        return self._nodes[name].read()


class ContainerPoll:
    """Looks at all nodes; what was unknown in one look is remembered for the next."""

    def __init__(self, nodes: Nodes, clock: Callable[[], float]) -> None:
        self._nodes = nodes
        self._clock = clock
        self._watched = Watched()

    def looks(self) -> tuple[Look, ...]:
        """One look at each node."""
        return tuple(self._look(name) for name in self._nodes.names())

    def _look(self, name: str) -> Look:
        try:
            seen = unknown(self._nodes.read(name))
        except (RobotKubeError, OSError) as error:
            return Look(MACHINE, node=name, problem=str(error))
        now = self._clock()
        self._watched = self._watched.after(name, seen, now)
        return Look(MACHINE, tuple(stranger(name, one) for one in self._watched.named(name, seen, now)), name)


def stranger(node: str, one: Unknown) -> Stranger:
    """A container that nobody of the cluster started. Which pod it says to be of stands in the message alone."""
    return Stranger(CONTAINER, "", one.container.key, BESIDE_THE_KUBELET, message(node, one))


class ClusterReports:
    """Reports looks to the cluster, and every ATTEND_SECONDS has it looked after (`attend`) that what was reported
    still stands. Where it takes none, it is asked again after AGAIN_SECONDS."""

    def __init__(
        self, report: Callable[[Look], None], clock: Callable[[], float], attend: Callable[[], None] = lambda: None
    ) -> None:
        self._report = report
        self._attend = attend
        self._clock = clock
        self._attended = float("-inf")
        self._again = float("-inf")
        self._problem = ""

    def __call__(self, looks: Iterable[Look]) -> str:
        """What keeps the looks from being reported; nothing when they were."""
        if self._clock() >= self._again:
            self._problem = self._reported(looks)
            self._again = self._clock() + AGAIN_SECONDS if self._problem else float("-inf")
        return self._problem

    def _reported(self, looks: Iterable[Look]) -> str:
        try:
            if self._clock() - self._attended >= ATTEND_SECONDS:
                self._attended = self._clock()
                self._attend()
            for look in looks:
                self._report(look)
        except NotInstalledError as error:
            return (
                f"namespace {NAMESPACE} takes no Inspections; they are written once the platform is installed: {error}"
            )
        except (InputError, UnavailableError) as error:  # as when admission refuses or changes what is written
            return str(error)
        return ""


def report_of(looks: Iterable[Look], problem: str, at: float) -> ContainerReport:
    """What `status` says of looks."""
    looks = list(looks)
    strangers = {look.node: [one.message for one in look.strangers] for look in looks if look.strangers}
    return ContainerReport(
        len(looks), at, strangers, {look.node: look.problem for look in looks if look.problem}, problem
    )


def poll_forever(
    poll: ContainerPoll,
    reports: Callable[[Iterable[Look]], str],
    keep: Callable[[ContainerReport], None],
    pause: Callable[[], None],
    clock: Callable[[], float],
) -> None:
    """Look for ever. `reports` tells the cluster, `keep` writes what `status` reads, when it is something else and now
    and then. What keeps the cluster from being told is logged when it comes and when it is another thing, with the
    strangers that are there."""
    kept: ContainerReport | None = None
    said = ""
    while True:
        looks = poll.looks()
        report = report_of(looks, reports(looks), clock())
        if not report.says(kept) or not 0 <= report.at - (kept or report).at < REPORT_SECONDS:
            keep(report)
            kept = report
        said = _say(report, said)
        pause()


def _say(report: ContainerReport, before: str) -> str:
    """Log what keeps the cluster from being told, unless it was said before; returns what is said now."""
    if not report.problem:
        return ""
    text = "; ".join([report.problem, *(text for texts in report.strangers.values() for text in texts)])
    if text != before:
        log.warning("containers: the Inspections do not say what was seen: %s", text)
    return text


def api_server(url: str, folders: ClusterFolders) -> ApiServer:
    """The API server, as the cluster's administrator, which the host is."""
    pki = folders.pki
    authority, certificate, key = (pki / name for name in ("ca.crt", "admin.crt", "admin.key"))
    return ApiServer(url, None, authority, API_SECONDS_MAX, certificate, key)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m ci.cluster.embedded.containers.polling", description=__doc__)
    parser.add_argument("--name", required=True, help="of the cluster")
    folders = ClusterFolders(parser.parse_args().name)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    api = api_server(f"https://{plan_of(folders.name).gateway}:{API_PORT}", folders)
    reporter = Reporter(KubernetesInspections(api, NAMESPACE, PROCESS, time.time), time.time_ns)
    poll_forever(
        ContainerPoll(ContainersOfNodes(folders), time.monotonic),
        ClusterReports(reporter.report, time.monotonic, reporter.attend),
        lambda report: report.write(folders),
        lambda: time.sleep(LOOK_SECONDS),
        time.time,
    )


if __name__ == "__main__":
    main()
