"""`make down` says what it removed, and that there was nothing when it is called again."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from ci.cluster import __main__ as commands
from ci.cluster import addresses, cleaning
from ci.cluster.processes import MARK
from ci.cluster.records import ClusterFolders, Record

pytestmark = pytest.mark.processes

NAME = "trial"


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
