"""What a commit brings, read within bounds whatever its trees and files are; no forge."""

from __future__ import annotations

import time
from pathlib import Path

import pygit2
import pytest
from pygit2.enums import FileMode

from robotkube.errors import DocumentError
from robotkube.foundation.forge.adapters.git import GitClone, clones
from robotkube.foundation.forge.ports.repositories import Commit

AUTHOR = pygit2.Signature("somebody", "somebody@example", 1_795_000_000, 0)
SECONDS_MAX = 10.0  # of the processor; what is refused or skipped would take hours
Tree = dict[str, "str | pygit2.Oid | Tree"]


class Stage:
    def __init__(self, folder: Path) -> None:
        self.clone = GitClone("http://forge.example", "robotkube/catalogue", "gate", "word", folder)
        self.repository = pygit2.Repository(str(folder))

    def tree(self, content: Tree) -> pygit2.Oid:
        """Text = file, mapping = folder, id = that tree."""
        builder = self.repository.TreeBuilder()
        for name, found in content.items():
            if isinstance(found, str):
                builder.insert(name, self.repository.create_blob(found.encode()), FileMode.BLOB)
            else:
                builder.insert(name, self.tree(found) if isinstance(found, dict) else found, FileMode.TREE)
        return builder.write()

    def commit(self, content: Tree, *parents: str, message: str = "some\n") -> str:
        return str(self.repository.create_commit(None, AUTHOR, AUTHOR, message, self.tree(content), list(parents)))

    def read(self, content: Tree, *parents: str) -> Commit:
        return self.clone.commit(self.commit(content, *parents))


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path / "clone")


def test_files_are_added_changed_removed_and_become_folders(stage: Stage) -> None:
    before: Tree = {"a": "1", "b": {"c": "2", "d": {"e": "3"}}, "f": "4", "g": {"h": "5"}}
    first = stage.commit(before)
    assert stage.clone.commit(first).changes == {"a": "1", "b/c": "2", "b/d/e": "3", "f": "4", "g/h": "5"}
    after: Tree = {"a": "1", "b": {"c": "new", "d": {}}, "f": {"now": "folder"}, "g": "file", "z": "last"}
    found = stage.read(after, first)
    expected = {"b/c": "new", "b/d/e": None, "f": None, "f/now": "folder", "g": "file", "g/h": None, "z": "last"}
    assert found.changes == expected
    assert stage.read(before, first).changes == {}


@pytest.mark.parametrize("leaf", [{"file": "x"}, {}])
def test_a_few_objects_that_spell_out_billions_of_paths_are_refused(stage: Stage, leaf: Tree) -> None:
    tree = stage.tree(leaf)
    for _ in range(10):
        tree = stage.tree({f"d{number}": tree for number in range(10)})
    began = time.thread_time()
    with pytest.raises(DocumentError, match="changes more than 1000 files; split it"):
        stage.read({"releases": tree})
    assert time.thread_time() - began < SECONDS_MAX


def test_deep_folders_are_refused(stage: Stage) -> None:
    tree = stage.tree({"file": "x"})
    for _ in range(2000):
        tree = stage.tree({"d": tree})
    with pytest.raises(DocumentError, match="nested deeper than 16 folders"):
        stage.read({"releases": tree})


def test_a_file_beyond_the_bound_is_not_even_read(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clones, "FILE_BYTES_MAX", 100)
    found = stage.read({"large": "x" * 101, "right": "x" * 100})
    assert (found.irregular, list(found.changes)) == (("large",), ["right"])


def test_texts_beyond_the_bound_together_are_refused(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clones, "CHANGED_CHARACTERS_MAX", 1000)
    assert stage.read({"a": "x" * 500, "b": "y" * 500}).irregular == ()
    with pytest.raises(DocumentError, match="brings more than 1000 characters"):
        stage.read({"a": "x" * 500, "b": "y" * 501})


def test_commits_that_touch_a_path_or_say_a_word(stage: Stage) -> None:
    policy, path = "policies/updates.yaml", "RobotKube-Cause: update\n"
    first = stage.commit({"a": "1"})
    second = stage.commit({"a": "1", "policies": {"updates.yaml": "{}"}}, first)
    third = stage.commit({"a": "2", "policies": {"updates.yaml": "{}"}}, second, message=f"deploy\n\n{path}")
    fourth = stage.commit({"a": "3", "policies": {"updates.yaml": "{}"}}, third)
    fifth = stage.commit({"a": "3"}, fourth)
    stage.clone.moved_to(fifth)
    assert [commit.id for commit in stage.clone.touching(None, 10, policy, [path])] == [second, third, fifth]
    assert [commit.id for commit in stage.clone.touching(second, 10, policy, [path])] == [third, fifth]
    assert [commit.id for commit in stage.clone.touching(None, 3, policy, [path])] == [third, fifth]
    assert stage.clone.touching(None, 10, policy, [path])[1].changes == {"a": "2"}


def test_a_long_history_is_looked_through_at_once(stage: Stage) -> None:
    tree, commit = {"releases": {"a": "1"}}, ""
    for _ in range(2000):
        commit = stage.commit(tree, *([commit] if commit else []))  # type: ignore[arg-type]
    stage.clone.moved_to(commit)
    began = time.thread_time()
    assert stage.clone.touching(None, 10_000, "policies/updates.yaml", ["RobotKube-Cause: update\n"]) == []
    assert time.thread_time() - began < SECONDS_MAX
