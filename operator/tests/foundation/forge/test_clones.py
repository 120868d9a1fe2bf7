"""What a commit brings, read within bounds whatever its trees and files are; no forge."""

from __future__ import annotations

import time
from pathlib import Path

import pygit2
import pytest
from pygit2.enums import FileMode

from robotkube.errors import DocumentError
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter, clones
from robotkube.foundation.forge.loops.merging import merge_commit, merge_message
from robotkube.foundation.forge.ports.pull_requests import PullRequest
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
        for name, entry in content.items():
            if isinstance(entry, str):
                builder.insert(name, self.repository.create_blob(entry.encode()), FileMode.BLOB)
            else:
                builder.insert(name, self.tree(entry) if isinstance(entry, dict) else entry, FileMode.TREE)
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
    files = stage.read(after, first)
    expected = {"b/c": "new", "b/d/e": None, "f": None, "f/now": "folder", "g": "file", "g/h": None, "z": "last"}
    assert files.changes == expected
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
    files = stage.read({"large": "x" * 101, "right": "x" * 100})
    assert (files.irregular, list(files.changes)) == (("large",), ["right"])


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
    tree = {"releases": {"a": "1"}}
    commit = ""
    for _ in range(2000):
        commit = stage.commit(tree, *([commit] if commit else []))  # type: ignore[arg-type]
    stage.clone.moved_to(commit)
    began = time.thread_time()
    assert stage.clone.touching(None, 10_000, "policies/updates.yaml", ["RobotKube-Cause: update\n"]) == []
    assert time.thread_time() - began < SECONDS_MAX


# -- joining with main ---------------------------------------------------------------------------------------------


def overlaps(stage: Stage, base: Tree, tip: Tree, head: Tree) -> list[str]:
    """Paths that both changed since `base`."""
    left = stage.commit(base)
    stage.clone.moved_to(stage.commit(tip, left, message="tip\n"))
    return list(stage.clone.overlaps(stage.clone.changes_since_branch(stage.commit(head, left, message="head\n"))))


@pytest.mark.parametrize(
    ("tip", "head", "expected"),
    [
        ({"a": "1", "b": {"c": "2"}, "new": "x"}, {"a": "mine", "b": {"c": "2", "d": "3"}}, []),
        ({"a": "theirs", "b": {"c": "2"}}, {"a": "mine", "b": {"c": "2"}}, ["a"]),
        ({"a": "same", "b": {"c": "2"}}, {"a": "same", "b": {"c": "2"}}, []),
        ({"b": {"c": "2"}}, {"a": "mine", "b": {"c": "2"}}, ["a"]),
        ({"a": "1"}, {"a": "1", "b": {}}, []),
        ({"a": "1", "b": {"c": "theirs"}}, {"a": "1"}, ["b/c"]),
        ({"a": "1", "b": "a file now"}, {"a": "1", "b": {"c": "2", "d": "new"}}, ["b/d"]),
        ({"a": "1", "b": {"c": "2"}, "n": "a file"}, {"a": "1", "b": {"c": "2"}, "n": {"m": "in a folder"}}, ["n/m"]),
        ({"a": "1", "b": {"c": "2"}, "n": {"m": "in a folder"}}, {"a": "1", "b": {"c": "2"}, "n": "a file"}, ["n"]),
    ],
)
def test_what_main_changed_as_well_cannot_be_joined(stage: Stage, tip: Tree, head: Tree, expected: list[str]) -> None:
    assert overlaps(stage, {"a": "1", "b": {"c": "2"}}, tip, head) == expected


def test_a_mode_that_main_changed_is_a_change(stage: Stage) -> None:
    left = stage.commit({"a": "1"})
    builder = stage.repository.TreeBuilder()
    builder.insert("a", stage.repository.create_blob(b"1"), FileMode.BLOB_EXECUTABLE)
    tip = stage.repository.create_commit(None, AUTHOR, AUTHOR, "tip\n", builder.write(), [left])
    stage.clone.moved_to(str(tip))
    head = stage.commit({"a": "2"}, left)
    assert stage.clone.overlaps(stage.clone.changes_since_branch(head)) == ["a"]


def test_a_merge_changes_what_the_branch_changed_and_keeps_the_rest_of_main(tmp_path: Path) -> None:
    stage = Stage(tmp_path / "clone")
    writer = ProposalWriter(tmp_path / "clone", "gate", "word", "gate", lambda: 1_795_000_000.0)
    left = stage.commit({"a": "1", "b": {"c": "2"}, "f": "file", "g": {"h": "folder"}})
    tip = stage.commit({"a": "1", "b": {"c": "2"}, "f": "file", "g": {"h": "folder"}, "main": "new"}, left)
    stage.clone.moved_to(tip)
    wrong = stage.commit({"a": "wrong", "b": {"c": "2"}, "f": "file", "g": {"h": "folder"}}, left)
    head = stage.commit({"a": "mine", "f": {"now": "folder"}, "g": "now a file"}, wrong, message="Mine\n\nX: y\n")
    change = stage.clone.changes_since_branch(head)
    pull = PullRequest(7, "", "", "somebody", "open", head, False)
    merge = merge_commit(stage.clone, writer, pull, change, ["one", "two"])
    assert merge.changes == change.changes
    assert stage.repository[merge.id].peel(pygit2.Commit).parent_ids == [pygit2.Oid(hex=tip), pygit2.Oid(hex=head)]
    expected: Tree = {"a": "mine", "f": {"now": "folder"}, "g": "now a file", "main": "new"}
    assert stage.repository[merge.id].peel(pygit2.Tree).id == stage.tree(expected)
    assert merge.author == "somebody"
    trailers = "RobotKube-Pull-Request: 7\nRobotKube-Approved-By: one\nRobotKube-Approved-By: two\n"
    assert merge.message == f"Mine (#7)\n\n{trailers}"


@pytest.mark.parametrize(("message", "subject"), [("", "Merge a pull request (#7)"), ("  a \t b\nc", "a b (#7)")])
def test_the_first_line_of_a_merge(message: str, subject: str) -> None:
    assert merge_message(7, message, ()).partition("\n")[0] == subject
