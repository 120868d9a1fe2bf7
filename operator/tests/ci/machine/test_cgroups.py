"""Folders and weights of a cluster's processes, in a tree that looks like either version."""

from __future__ import annotations

from pathlib import Path

import pytest

from ci.cluster_contract.topology import WEIGHT, WEIGHTS, NodeSpec
from ci.machine import cgroups

CLUSTER = "weighed"


@pytest.fixture
def first_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Hierarchies for processor time, its accounting and memory; a folder of the kernel's begins with 1024 shares."""
    monkeypatch.setattr(cgroups, "ROOT", tmp_path)
    for hierarchy in ("cpu", "cpuacct", "memory"):
        for folder in ("", "robotkube-weighed", "robotkube-weighed/platform-0", "robotkube-weighed/vehicle-00"):
            place = tmp_path / hierarchy / folder
            place.mkdir(exist_ok=True)
            (place / "cgroup.procs").touch()
    for folder in ("daemons", "daemons/etcd", "daemons/vehicle-00.kubelet"):
        (tmp_path / "cpu/robotkube-weighed" / folder).mkdir()
    for folder in [p for p in (tmp_path / "cpu").rglob("*") if p.is_dir()]:
        (folder / "cpu.shares").write_text("1024")
    return tmp_path


def shares(root: Path, folder: str) -> int:
    return int((root / "cpu/robotkube-weighed" / folder / "cpu.shares").read_text())


def node(role: str) -> NodeSpec:
    return NodeSpec(f"{role}-00", role, f"{role}-00", 1000, 2**30, ())


def test_nodes_weigh_by_what_waits_for_them(first_version: Path) -> None:
    for name, role in (("platform-0", "platform"), ("vehicle-00", "vehicle")):
        cgroups.node_root(CLUSTER, name, node(role).weight)
    assert shares(first_version, "vehicle-00") == 1024 * WEIGHT // 100
    assert shares(first_version, "platform-0") == 1024 * WEIGHTS["platform"] // 100


def test_a_daemon_is_where_its_time_is_counted_and_where_it_is_weighed(first_version: Path) -> None:
    groups = cgroups.daemon_folders(CLUSTER, "etcd", 400)
    assert {folder.relative_to(first_version).parts[0] for folder in groups} == {"cpu", "cpuacct"}
    assert all(folder.is_dir() for folder in groups)
    assert shares(first_version, "daemons/etcd") == 4096
    assert shares(first_version, ".") == cgroups.TOP_WEIGHT * 1024 // 100
    assert shares(first_version, "daemons") == cgroups.DAEMONS_WEIGHT * 1024 // 100


def test_a_daemon_that_is_started_again_keeps_its_weight(first_version: Path) -> None:
    cgroups.daemon_folders(CLUSTER, "vehicle-00.kubelet", 25)
    cgroups.daemon_folders(CLUSTER, "vehicle-00.kubelet")
    assert shares(first_version, "daemons/vehicle-00.kubelet") == 256


def test_one_hierarchy_takes_the_weight_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cgroups, "ROOT", tmp_path)
    (tmp_path / "cgroup.controllers").write_text("cpu memory\n")
    (tmp_path / "cgroup.subtree_control").touch()
    place = tmp_path / "robotkube-weighed" / "cloud-0"
    place.mkdir(parents=True)
    (place.parent / "cgroup.controllers").write_text("cpu memory\n")
    (place / "cpu.weight").write_text("100")
    cgroups.node_root(CLUSTER, "cloud-0", node("cloud").weight)
    assert (place / "cpu.weight").read_text() == str(WEIGHTS["cloud"])
