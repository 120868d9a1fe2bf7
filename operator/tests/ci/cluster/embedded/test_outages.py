"""A node's daemons are found by their records; a name that is no node is refused."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from ci.cluster.embedded import outages
from ci.cluster.embedded.host.processes import Process
from ci.cluster.embedded.host.records import ClusterFolders
from ci.errors import SetUpError

pytestmark = pytest.mark.toolchain

ENTER = ("/usr/bin/nsenter", "--net=/proc/1/ns/net", "--mount=/proc/1/ns/mnt")
CLUSTER = "outages"  # never the name of one that may run: its processes would be killed
BINARIES = "/somewhere/toolchain/bin"


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ClusterFolders:
    """The records of a cluster with one node whose processes have all ended."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cluster_folders = ClusterFolders(CLUSTER)
    cluster_folders.processes.mkdir(parents=True)
    for name in ("node", *outages.DAEMONS):
        command = (*ENTER, f"{BINARIES}/{name}", "--config", "x")
        process = Process(f"vehicle-00.{name}", 2**22 + 1, 1, command, str(tmp_path / "log"))
        (cluster_folders.processes / f"{process.name}.json").write_text(json.dumps(asdict(process)))
    return cluster_folders


def test_daemons_come_in_the_order_in_which_they_start(folders: ClusterFolders) -> None:
    daemons = outages._daemons(folders, "vehicle-00")
    assert [process.name for process in daemons] == [f"vehicle-00.{name}" for name in outages.DAEMONS]
    assert {str(outages._program(process).parent) for process in daemons} == {BINARIES}


def test_stopping_what_has_stopped_is_fine(folders: ClusterFolders) -> None:
    outages.stop(CLUSTER, "vehicle-00")


def test_what_is_no_node_is_refused(folders: ClusterFolders) -> None:
    with pytest.raises(SetUpError, match=r"no process vehicle-01\.containerd; name a node of its topology"):
        outages.stop(CLUSTER, "vehicle-01")
