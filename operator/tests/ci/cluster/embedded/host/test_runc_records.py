"""What runc wrote down is read; what is no record of it, and processes that have ended, say nothing."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from ci.cluster.embedded.host import processes, runc_records
from ci.cluster.embedded.host.processes import start_ticks
from ci.machine import cgroups

CLUSTER = "trial"


@pytest.fixture
def hierarchy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of the only hierarchy of control groups."""
    place = tmp_path / "cgroup"
    place.mkdir()
    (place / "cgroup.controllers").touch()
    monkeypatch.setattr(cgroups, "ROOT", place)
    return place


def write(nodes: Path, node: str, name: str, state: object) -> None:
    folder = nodes / node / "run/containerd/runc/default" / name
    folder.mkdir(parents=True)
    (folder / "state.json").write_text(json.dumps(state) if not isinstance(state, str) else state)


def own(**more: Any) -> dict[str, Any]:
    return {"init_process_pid": os.getpid(), "init_process_start": start_ticks(os.getpid()), **more}


def test_the_first_process_of_a_container_is_known_by_its_start(tmp_path: Path) -> None:
    write(tmp_path, "vehicle-00", "runs", own())
    write(tmp_path, "vehicle-01", "ended", own(init_process_start=1))
    assert processes.in_containers(tmp_path) == {os.getpid()}
    assert processes.in_containers(tmp_path, "vehicle-01") == set()


@pytest.mark.parametrize("state", ["", "{", [], {}, {"init_process_pid": "1"}, {"cgroup_paths": None}])
def test_what_is_no_record_says_nothing(tmp_path: Path, hierarchy: Path, state: object) -> None:
    write(tmp_path, "vehicle-00", "x", state)
    assert runc_records.first_processes(tmp_path) == set()
    assert runc_records.foreign_groups(tmp_path, CLUSTER) == ()


def test_control_groups_outside_of_the_clusters_are_foreign_and_removed(tmp_path: Path, hierarchy: Path) -> None:
    foreign, nested = hierarchy / "default/miner", hierarchy / "default/miner/deeper"
    inside, gone, elsewhere = hierarchy / "robotkube-trial/vehicle-00/pod", hierarchy / "default/gone", tmp_path / "x"
    for folder in (nested, inside, elsewhere):
        folder.mkdir(parents=True)
    for number, path in enumerate((foreign, inside, gone, elsewhere, hierarchy)):
        write(tmp_path, "vehicle-00", str(number), {"cgroup_paths": {"": str(path)}})
    assert runc_records.foreign_groups(tmp_path, CLUSTER) == (foreign,)
    assert cgroups.remove_foreign([foreign]) == ()
    assert sorted(path.name for path in hierarchy.iterdir()) == ["cgroup.controllers", "robotkube-trial"]


def test_a_control_group_with_members_stays_and_so_does_what_others_have(
    tmp_path: Path, hierarchy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cgroups, "REMOVAL_ATTEMPTS", 1)
    monkeypatch.setattr(cgroups, "REMOVAL_PAUSE_SECONDS", 0)
    busy, other = hierarchy / "default/busy", hierarchy / "default/of-others"
    for folder in (busy, other):
        folder.mkdir(parents=True)
    (busy / "member").touch()
    assert cgroups.remove_foreign([busy]) == (busy,)
    assert other.is_dir()
