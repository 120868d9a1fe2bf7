"""`make down` says what it removed, and that there was nothing when it is called again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import pytest

from ci.cluster import __main__ as commands
from ci.cluster.embedded import cleaning
from ci.cluster.embedded.host import mounts
from ci.cluster.embedded.host.processes import MARK, Process, start_ticks
from ci.cluster.embedded.host.records import ClusterFolders, Record
from ci.cluster.embedded.network import addresses
from ci.folders import PROJECT
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

NAME = "trial"
MOUNTING = 'mount -t tmpfs trial "$1" && mount -t tmpfs trial "$2" && touch "$3" && exec sleep 600'


@pytest.fixture(autouse=True)
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ClusterFolders:
    """A cluster of its own name, addresses and cache folder, of which nothing is there."""
    plan = addresses._plan(NAME, "10.91.0.0/24", "10.246.0.0/16", "10.98.0.0/16")
    monkeypatch.setitem(addresses.PLANS, NAME, plan)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return ClusterFolders(NAME)


@pytest.fixture
def process() -> Iterator[subprocess.Popen[bytes]]:
    """A process that bears the cluster's mark."""
    with subprocess.Popen(["sleep", "600"], env={**os.environ, MARK: NAME}) as process:
        yield process
        process.kill()


def down(capsys: pytest.CaptureFixture[str]) -> list[str]:
    commands.run(commands.arguments().parse_args(["down", "--name", NAME]))
    return capsys.readouterr().out.splitlines()


def test_what_was_removed_is_said_once(
    folders: ClusterFolders,
    tmp_path: Path,
    process: subprocess.Popen[bytes],
    capsys: pytest.CaptureFixture[str],
) -> None:
    made = tmp_path / "made"
    for folder in (made, folders.log, folders.pki):
        folder.mkdir(parents=True)
    folders.kubeconfig.write_text("x")
    Record(made_folders=[str(made)]).write(folders.record)
    assert down(capsys) == [
        "cluster trial: removed",
        "  1 process",
        f"  folders: {made}",
        f"  files of {folders.base}: kubeconfig, pki, record.json",
        f"  kept: the logs in {folders.log}",
    ]
    assert process.wait(10) == -9
    assert list(folders.base.iterdir()) == [folders.log]
    assert down(capsys) == ["cluster trial: nothing to remove"]


def test_network_namespaces_are_those_of_the_nodes(process: subprocess.Popen[bytes]) -> None:
    assert cleaning._networks([process.pid, os.getpid(), 2**22 + 1]) == set()


def test_a_machine_without_the_cluster_has_nothing_to_remove(capsys: pytest.CaptureFixture[str]) -> None:
    assert down(capsys) == ["cluster trial: nothing to remove"]


@pytest.fixture
def node(folders: ClusterFolders, tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The recorded process of a node, which has mounted two file systems: in a mount namespace of its own."""
    places = [folders.base / "node" / "a", folders.base / "node" / "b"]
    for folder in (*places, folders.processes):
        folder.mkdir(parents=True)
    mounted = tmp_path / "mounted"
    command = ["unshare", "--mount", "sh", "-ec", MOUNTING, "node", *map(str, places), str(mounted)]
    with subprocess.Popen(command, env={**os.environ, MARK: NAME}) as process:
        until(mounted.exists, "the node's mounts")
        record = Process("cloud-0.node", process.pid, start_ticks(process.pid) or 0, (), "")
        (folders.processes / "cloud-0.node.json").write_text(json.dumps(asdict(record)))
        yield process
        process.kill()


def test_the_mounts_of_a_node_are_counted_and_end_with_it(
    folders: ClusterFolders, node: subprocess.Popen[bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    assert mounts.below(folders.base) == ()
    assert down(capsys)[:3] == ["cluster trial: removed", "  1 process", "  2 mounts"]
    assert node.wait(10) == -9
    assert list(folders.base.iterdir()) == []


def test_a_mount_of_this_machine_is_counted_and_unmounted(folders: ClusterFolders) -> None:
    """In a mount namespace of its own, so that this machine's stays as it is."""
    place = folders.base / "left behind"
    place.mkdir(parents=True)
    program = f"""
from ci.cluster.embedded import cleaning
from ci.cluster.embedded.network import addresses
addresses.PLANS["{NAME}"] = addresses._plan("{NAME}", "10.91.0.0/24", "10.246.0.0/16", "10.98.0.0/16")
print(*cleaning.leftovers("{NAME}"), *cleaning.remove("{NAME}"), *cleaning.leftovers("{NAME}"), sep="\\n")
"""
    script = 'mount -t tmpfs trial "$1" && exec "$2" -c "$3"'
    command = ["unshare", "--mount", "sh", "-ec", script, "sh", str(place), sys.executable, program]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines() == [f"mount {place}", "1 mount", f"files of {folders.base}: left behind"]
