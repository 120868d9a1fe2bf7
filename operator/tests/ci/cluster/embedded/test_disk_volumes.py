"""Files in volume claims whose volumes are folders of this machine."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from ci.cluster.embedded import disk_volumes
from ci.cluster.embedded.disk_volumes import DiskVolumes
from ci.errors import SetUpError

CLAIM = ("vehicle-00", "bags")


class Answers:
    """An API server with one claim and the volumes of its agent."""

    def __init__(self, folder: Path, bound: str = "", free: bool = True) -> None:
        self.folder, self.bound, self.free = folder, bound, free
        self.written: list[Any] = []

    def get(self, path: str) -> Any:
        if "persistentvolumeclaims" in path:
            phase = "Bound" if self.bound else "Pending"
            return {"spec": {"volumeName": self.bound}, "status": {"phase": phase}}
        if "labelSelector" in path:
            assert path.endswith("robotkube.io/agent%3Dvehicle-00")
            claimed = {} if self.free else {"claimRef": {"name": "other"}}
            return {"items": [{"metadata": {"name": "v-0"}, "spec": claimed, "status": {"phase": "Available"}}]}
        return {"spec": {"local": {"path": str(self.folder)}}}

    def merge(self, path: str, change: Any) -> Any:
        self.written.append((path, change["spec"]["claimRef"]["name"]))
        self.bound = "v-0"


def volumes(api: Answers) -> DiskVolumes:
    return DiskVolumes(api)  # type: ignore[arg-type]


def test_a_claim_that_nobody_used_gets_a_free_volume_of_its_agent(tmp_path: Path) -> None:
    api = Answers(tmp_path)
    volumes(api).use([CLAIM])
    assert api.written == [("/api/v1/persistentvolumes/v-0", "bags")]
    volumes(api).use([CLAIM])
    assert len(api.written) == 1, "one that is bound stays"
    with pytest.raises(SetUpError, match=r"no volume of agent vehicle-00 is free \(there are: v-0 Available\)"):
        volumes(Answers(tmp_path, free=False)).use([CLAIM])


def test_files_are_read_where_they_are(tmp_path: Path) -> None:
    disk = volumes(Answers(tmp_path, "v-0"))
    (tmp_path / "a").write_bytes(b"12345")
    assert disk.fetch(CLAIM, "a") == tmp_path / "a"
    assert disk.end_of(CLAIM, "a", 2) == b"45"
    assert disk.end_of(CLAIM, "a", 20) == b"12345"
    assert disk.end_of(CLAIM, "b", 20) == b""
    disk.make(CLAIM, "ledger")
    disk.make(CLAIM, "ledger")
    assert (tmp_path / "ledger").stat().st_uid == disk_volumes.OWNER or os.getuid() != 0
    assert not disk.place(CLAIM, bag(tmp_path / "bags" / "vehicle-00"))
    assert (tmp_path / "vehicle-00" / "vehicle-00.mcap").is_file()


def bag(folder: Path, text: str = "bag") -> Path:
    folder.mkdir(parents=True)
    (folder / "metadata.yaml").write_text("version: 5")
    (folder / "vehicle-00.mcap").write_text(text)
    return folder


def test_a_bag_is_linked_into_the_claim_once(tmp_path: Path) -> None:
    claim = tmp_path / "claim"
    claim.mkdir()
    source = bag(tmp_path / "bag")
    assert not disk_volumes.place(source, claim / "vehicle-00")
    assert (claim / "vehicle-00" / "vehicle-00.mcap").samefile(source / "vehicle-00.mcap")
    assert not disk_volumes.place(source, claim / "vehicle-00")


def test_another_bag_replaces_the_one_that_is_there(tmp_path: Path) -> None:
    claim = tmp_path / "claim"
    claim.mkdir()
    disk_volumes.place(bag(tmp_path / "first"), claim / "vehicle-00")
    assert disk_volumes.place(bag(tmp_path / "second", "other"), claim / "vehicle-00")
    assert (claim / "vehicle-00" / "vehicle-00.mcap").read_text() == "other"
    assert sorted(entry.name for entry in claim.iterdir()) == ["vehicle-00"]


def test_what_an_interrupted_placing_left_is_no_bag(tmp_path: Path) -> None:
    claim = tmp_path / "claim"
    (claim / ".vehicle-00.partial").mkdir(parents=True)
    (claim / ".vehicle-00.partial" / "half").write_text("x")
    disk_volumes.place(bag(tmp_path / "bag"), claim / "vehicle-00")
    assert sorted(file.name for file in (claim / "vehicle-00").iterdir()) == ["metadata.yaml", "vehicle-00.mcap"]
