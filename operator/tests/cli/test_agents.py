"""The command `robotkube agent rights`: each right with the release and the commit that gave it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pygit2
import pytest

from robotkube.cli.main import main
from robotkube.delivery.deployment.core.releases import Release
from tests.stages.delivery.main_of_links import POSE_00, POSE_01, bridge, texts

SIGNATURE = pygit2.Signature("manager", "manager@forge.invalid", 1_795_000_000, 0)


class Repository:
    """A clone of a deployment repository; `merge` makes a commit with these releases and no others."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._repository = pygit2.init_repository(str(folder), bare=True, initial_head="main")
        self._parents: list[pygit2.Oid] = []

    def merge(self, subject: str, *releases: Release, **files: str) -> str:
        index = pygit2.Index()
        for path, text in {**texts(*releases), **files}.items():
            blob = self._repository.create_blob(text.encode())
            index.add(pygit2.IndexEntry(path, blob, pygit2.enums.FileMode.BLOB))
        tree = index.write_tree(self._repository)
        commit = self._repository.create_commit("refs/heads/main", SIGNATURE, SIGNATURE, subject, tree, self._parents)
        self._parents = [commit]
        return str(commit)[:12]


@pytest.fixture
def repository(tmp_path: Path) -> Repository:
    return Repository(tmp_path / "deployment.git")


def shown(repository: Repository, capsys: pytest.CaptureFixture[str], agent: str, role: str) -> list[dict[str, Any]]:
    words = ["agent", "rights", agent, "--role", role, "--clone", str(repository.folder), "-o", "json"]
    assert main(words) == 0
    return list(json.loads(capsys.readouterr().out)["rights"])


def test_each_right_names_the_commit_that_gave_it(repository: Repository, capsys: pytest.CaptureFixture[str]) -> None:
    repository.merge("begin", bridge("vehicle-01", POSE_00))
    repository.merge("pose, for the first time", bridge("vehicle-00", POSE_01))
    repository.merge("withdrawn", bridge("vehicle-01", POSE_00))
    again = repository.merge("pose again", bridge("vehicle-00", POSE_01))
    plan = repository.merge("and a plan", bridge("vehicle-00", POSE_01, "/agents/cloud_0/plan"))
    rows = shown(repository, capsys, "vehicle-00", "vehicle")
    given = {row["topic"]: (row["given_by"], row["commit"], row["subject"]) for row in rows if row["commit"]}
    assert given == {
        "mqtt/vehicles/vehicle_01/pose": ("vehicle-00/mqtt-bridge", again, "pose again"),
        "mqtt/agents/cloud_0/plan": ("vehicle-00/mqtt-bridge", plan, "and a plan"),
    }
    always = {(row["may"], row["topic"]) for row in rows if row["given_by"] == "always"}
    assert {("write", "mqtt/vehicles/vehicle_00/#"), ("write", "robotkube/tasks/vehicle-00")} <= always
    assert rows[0]["may"] == "write"


def test_a_file_that_cannot_be_read_takes_nothing_away(
    repository: Repository, capsys: pytest.CaptureFixture[str]
) -> None:
    first = repository.merge("begin", bridge("cloud-0", "/vehicles/{agent}/pose"))
    repository.merge("broken", **{"releases/cloud-0/mqtt-bridge.yaml": "no release"})
    [row] = [row for row in shown(repository, capsys, "cloud-0", "cloud") if row["commit"]]
    assert (row["topic"], row["commit"]) == ("mqtt/vehicles/+/pose", first)


def test_without_a_cluster_the_role_is_needed(repository: Repository, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["agent", "rights", "vehicle-00", "--clone", str(repository.folder)]) == 2
    assert "give the agent's --role" in capsys.readouterr().err
