"""The process `containers`: strangers become Inspections, what cannot be seen or written is said, and `status` names
all of it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from ci.cluster.embedded.containers import reports
from ci.cluster.embedded.containers.beside_kubelets import GRACE_SECONDS, NodeContents, RuntimeContainer
from ci.cluster.embedded.containers.node_containers import RUNNING
from ci.cluster.embedded.containers.polling import (
    AGAIN_SECONDS,
    LOOK_SECONDS,
    ClusterReports,
    ContainerPoll,
    ContainersOfNodes,
    poll_forever,
)
from ci.cluster.embedded.containers.reports import PROCESS, REPORT_SECONDS, SILENT_SECONDS_MAX, ContainerReport
from ci.cluster.embedded.host.processes import Process, start_ticks
from ci.cluster.embedded.host.records import ClusterFolders
from robotkube.delivery.inspection.loops.reporting import Reporter
from robotkube.delivery.inspection.ports import NotInstalledError
from robotkube.errors import InputError, UnavailableError
from tests.stages.delivery.inspection.inspections_in_memory import Clock, InspectionsInMemory

CLUSTER = "containers"
NAMED_SECONDS_MAX = 15
FOREIGN = RuntimeContainer("default", "miner", program="/bin/miner")
CLAIMING = RuntimeContainer("k8s.io", "miner", program="/bin/miner")


class TwoNodes:
    """Nodes in memory; one that is None cannot be read."""

    def __init__(self) -> None:
        self.nodes: dict[str, NodeContents | None] = {"vehicle-00": NodeContents(), "vehicle-01": NodeContents()}

    def names(self) -> Iterable[str]:
        return list(self.nodes)

    def read(self, name: str) -> NodeContents:
        node = self.nodes[name]
        if node is None:
            raise UnavailableError("its containerd does not run")
        return node


class Inspections(InspectionsInMemory):
    """The cluster's Inspections; `failure` is raised by whatever is asked."""

    def __init__(self) -> None:
        super().__init__()
        self.failure: Exception | None = None
        self.asked = 0

    def _answer(self) -> None:
        self.asked += 1
        if self.failure:
            raise self.failure


class EndedError(Exception):
    """The loop has turned as often as a test wants."""


class Cluster:
    """The process's loop on nodes and a cluster in memory."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.nodes = TwoNodes()
        self.inspections = Inspections()
        self.kept: list[ContainerReport] = []
        self.poll = ContainerPoll(self.nodes, self.clock)
        self.reporter = Reporter(self.inspections, self.clock.ns)
        self.reports = ClusterReports(self.reporter.report, self.clock, self.reporter.attend)

    def look(self, seconds: float = LOOK_SECONDS) -> None:
        """Look for so long."""
        end = self.clock.now + seconds

        def pause() -> None:
            self.clock.now += LOOK_SECONDS
            if self.clock.now >= end:
                raise EndedError

        with pytest.raises(EndedError):
            poll_forever(self.poll, self.reports, self.kept.append, pause, self.clock)

    def condition(self, node: str, kind: str) -> str:
        return self.inspections.conditions(f"machine.{node}")[kind]

    def names(self, node: str) -> list[str]:
        return [one["name"] for one in self.inspections.statuses[f"machine.{node}"]["strangers"]]


@pytest.fixture
def cluster() -> Cluster:
    return Cluster()


def test_every_node_has_an_inspection(cluster: Cluster) -> None:
    cluster.look()
    assert sorted(cluster.inspections.statuses) == ["machine.vehicle-00", "machine.vehicle-01"]
    assert cluster.condition("vehicle-00", "Seen") == cluster.condition("vehicle-00", "Clean") == "True"
    assert cluster.kept[-1].nodes == 2


@pytest.mark.parametrize("foreign", [FOREIGN, CLAIMING])
def test_a_stranger_is_named_within_15_seconds_and_gone_after_it_has_ended(
    cluster: Cluster, foreign: RuntimeContainer
) -> None:
    cluster.look()
    cluster.nodes.nodes["vehicle-00"] = NodeContents((foreign,))
    cluster.look(NAMED_SECONDS_MAX - LOOK_SECONDS)  # it began right after a look
    assert cluster.names("vehicle-00") == [foreign.key]
    assert cluster.condition("vehicle-00", "Clean") == "False"
    assert cluster.names("vehicle-01") == []
    assert cluster.kept[-1].strangers.keys() == {"vehicle-00"}
    cluster.nodes.nodes["vehicle-00"] = NodeContents()
    cluster.look()
    assert (cluster.names("vehicle-00"), cluster.kept[-1].strangers) == ([], {})
    assert cluster.inspections.events == [
        ("machine.vehicle-00", "BesideTheKubelet", f"Container {foreign.key}"),
        ("machine.vehicle-00", "StrangerGone", f"Container {foreign.key}"),
    ]


def test_a_pod_that_starts_raises_no_alarm(cluster: Cluster) -> None:
    """Its container runs before its kubelet has written it down."""
    for _ in range(3):
        cluster.nodes.nodes["vehicle-00"] = NodeContents((CLAIMING,))
        cluster.look(GRACE_SECONDS - LOOK_SECONDS)
        cluster.nodes.nodes["vehicle-00"] = NodeContents()
        cluster.look()
    assert cluster.inspections.events == []


def test_of_a_node_that_cannot_be_read_nothing_is_claimed(cluster: Cluster) -> None:
    cluster.nodes.nodes["vehicle-00"] = NodeContents((FOREIGN,))
    cluster.look()
    cluster.nodes.nodes["vehicle-00"] = None
    cluster.look()
    assert (cluster.condition("vehicle-00", "Seen"), cluster.condition("vehicle-00", "Clean")) == ("False", "Unknown")
    assert cluster.names("vehicle-00") == [FOREIGN.key]
    assert cluster.kept[-1].unseen == {"vehicle-00": "its containerd does not run"}
    assert cluster.condition("vehicle-01", "Seen") == "True"


@pytest.mark.parametrize(
    ("failure", "words"),
    [
        (
            NotInstalledError("no such kind"),
            "takes no Inspections; they are written once the platform is installed: no such kind",
        ),
        (UnavailableError("nobody answers"), "say what was seen: nobody answers; "),
        (InputError("PATCH x: a policy denied the request"), "say what was seen: PATCH x: a policy denied the request"),
    ],
)
def test_while_the_cluster_takes_no_inspections_it_is_said_once_and_strangers_are_named(
    cluster: Cluster, caplog: pytest.LogCaptureFixture, failure: Exception, words: str
) -> None:
    cluster.inspections.failure = failure
    cluster.nodes.nodes["vehicle-00"] = NodeContents((FOREIGN,))
    cluster.look(20)
    [record] = caplog.records
    assert words in record.getMessage()
    assert "container default/miner on node vehicle-00 runs /bin/miner" in record.getMessage()
    assert cluster.kept[-1].strangers.keys() == {"vehicle-00"}
    assert cluster.inspections.asked <= 20 / AGAIN_SECONDS + 1, "it is asked in every look"
    cluster.inspections.failure = None
    cluster.look(AGAIN_SECONDS + LOOK_SECONDS)
    assert cluster.names("vehicle-00") == [FOREIGN.key]
    assert cluster.kept[-1].problem == ""


def test_when_admission_changes_what_is_written_that_is_what_is_said(
    cluster: Cluster, caplog: pytest.LogCaptureFixture
) -> None:
    """Not that the platform is not installed: it is, and somebody has it say that nothing is strange."""
    cluster.inspections.changes = lambda status: {**status, "strangers": [], "strangersTotal": 0}
    cluster.nodes.nodes["vehicle-00"] = NodeContents((FOREIGN,))
    cluster.look(20)
    said = caplog.records[-1].getMessage()
    assert said.startswith(
        "containers: the Inspections do not say what was seen: Inspection machine.vehicle-00: the API server has "
        "something else than what was written, so do not believe it. Look for a mutating policy or webhook"
    )
    assert "container default/miner on node vehicle-00 runs /bin/miner" in said
    assert "takes no Inspections" not in cluster.kept[-1].problem


def test_the_report_is_kept_when_it_says_something_else_and_now_and_then(cluster: Cluster) -> None:
    cluster.look(REPORT_SECONDS)
    assert len(cluster.kept) == 1
    cluster.look(LOOK_SECONDS)
    assert len(cluster.kept) == 2, "a process that starts again says so"


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ClusterFolders:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cluster_folders = ClusterFolders(CLUSTER)
    cluster_folders.processes.mkdir(parents=True)
    return cluster_folders


def record(folders: ClusterFolders, name: str, alive: bool = True) -> None:
    process = Process(name, 1, (start_ticks(1) or 0) + (not alive), ("x",), "log")
    (folders.processes / f"{name}.json").write_text(json.dumps(asdict(process)), encoding="utf-8")


def test_the_nodes_are_those_whose_runtimes_are_recorded(folders: ClusterFolders) -> None:
    record(folders, "vehicle-00.containerd")
    record(folders, "vehicle-01.containerd", alive=False)
    (folders.node("vehicle-00") / RUNNING[0] / "default" / "miner").mkdir(parents=True)
    nodes = ContainersOfNodes(folders)
    assert list(nodes.names()) == ["vehicle-00", "vehicle-01"]
    assert [container.key for container in nodes.read("vehicle-00").containers] == ["default/miner"]
    with pytest.raises(UnavailableError, match="its containerd does not run; start the node again"):
        nodes.read("vehicle-01")


def test_status_says_that_nobody_looks(folders: ClusterFolders) -> None:
    assert "has no process containers; start it anew" in reports.status(folders)
    record(folders, PROCESS)
    assert "the process containers does not look" in reports.status(folders)
    ContainerReport(2, 100.0).write(folders)
    assert reports.status(folders, 100.0 + SILENT_SECONDS_MAX) == "containers: none beside the kubelets of 2 nodes"
    assert "does not look" in reports.status(folders, 101.0 + SILENT_SECONDS_MAX)


def test_status_names_strangers_and_what_was_not_seen(folders: ClusterFolders) -> None:
    record(folders, PROCESS)
    report = ContainerReport(
        2, 100.0, {"vehicle-00": ["container default/miner on node vehicle-00: why"]}, {"cloud-0": "dark"}
    )
    replace(report, problem="nobody answers").write(folders)
    assert reports.status(folders, 100.0).splitlines() == [
        "containers: 1 STARTED BESIDE THE KUBELETS of 2 nodes",
        "  container default/miner on node vehicle-00: why",
        "  cloud-0 was not looked at: dark",
        f"  the Inspections do not say what was seen: nobody answers ({folders.log / 'containers.log'})",
    ]


def test_what_somebody_wrote_into_an_inspection_is_written_over(cluster: Cluster) -> None:
    cluster.look(10)
    cluster.inspections.remove("machine.vehicle-00")
    cluster.look(7)
    assert "machine.vehicle-00" in cluster.inspections.names()
