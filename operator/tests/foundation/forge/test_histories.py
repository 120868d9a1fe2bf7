"""The whole history of a repository from a clone on disk: main along its moves, notes and what became of them."""

from __future__ import annotations

from pathlib import Path

import pygit2
import pytest
from pygit2.enums import FileMode

from robotkube.foundation.forge.adapters.git import GitHistory

NOTES = "refs/notes/robotkube"
FIRST, SECOND = "1" * 40, "2" * 40
WHO = pygit2.Signature("somebody", "somebody@example", 1_795_000_000, 0)
Content = dict[str, "str | Content"]


class Stage:
    def __init__(self, folder: Path) -> None:
        self.repository = pygit2.init_repository(str(folder), bare=True, initial_head="main")
        self.folder = folder

    def tree(self, content: Content) -> pygit2.Oid:
        builder = self.repository.TreeBuilder()
        for name, entry in content.items():
            if isinstance(entry, str):
                builder.insert(name, self.repository.create_blob(entry.encode()), FileMode.BLOB)
            else:
                builder.insert(name, self.tree(entry), FileMode.TREE)
        return builder.write()

    def commit(self, content: Content, *parents: str, reference: str = "refs/heads/main") -> str:
        """A commit that the reference is moved to."""
        made = self.repository.create_commit(None, WHO, WHO, "some\n", self.tree(content), list(parents))
        self.repository.references.create(reference, made, force=True)
        return str(made)

    def notes(self, *states: Content) -> GitHistory:
        """A history of notes with these states, one commit each."""
        parents: list[str] = []
        for state in states:
            parents = [self.commit(state, *parents, reference=NOTES)]
        return GitHistory(self.folder)


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path / "clone.git")


def test_notes_are_read_with_their_history(stage: Stage) -> None:
    notes = stage.notes({FIRST: "a"}, {FIRST: "a", SECOND: "b"}).notes(NOTES)
    assert (notes.texts, notes.edits, len(notes.commits)) == ({FIRST: "a", SECOND: "b"}, (), 2)


def test_notes_that_move_to_folders_are_no_edits(stage: Stage) -> None:
    spread: Content = {"11": {FIRST[2:]: "a"}, "22": {"22": {SECOND[4:]: "b"}}}
    notes = stage.notes({FIRST: "a", SECOND: "b"}, spread).notes(NOTES)
    assert (notes.texts, notes.edits) == ({FIRST: "a", SECOND: "b"}, ())


def test_changed_and_removed_notes_are_edits_oldest_first(stage: Stage) -> None:
    notes = stage.notes({FIRST: "a", SECOND: "b"}, {FIRST: "c", SECOND: "b"}, {"11": {FIRST[2:]: "d"}}).notes(NOTES)
    edits = [(edit.annotated, edit.removed) for edit in notes.edits]
    assert edits == [(FIRST, False), (FIRST, False), (SECOND, True)]


def test_what_is_no_note_is_left_out(stage: Stage) -> None:
    notes = stage.notes({"README": "words", FIRST: "a", "11": {"README": "words"}}).notes(NOTES)
    assert notes.texts == {FIRST: "a"}
    assert GitHistory(stage.folder).notes("refs/notes/other").texts == {}


def test_main_goes_back_to_where_it_stood_when_that_is_known(stage: Stage) -> None:
    first = stage.commit({"a": "1"})
    second = stage.commit({"a": "1", "b": "1"}, first)
    side = stage.commit({"a": "1", "c": "1"}, first)
    merge = stage.commit({"a": "1", "b": "1", "c": "1"}, side, second)
    history = GitHistory(stage.folder)
    along_parents = [(commit.id, dict(commit.changes)) for commit in history.commits({})]
    assert along_parents == [(first, {"a": "1"}), (side, {"c": "1"}), (merge, {"b": "1"})]
    moves = [(commit.id, dict(commit.changes)) for commit in history.commits({merge: second})]
    assert moves == [(first, {"a": "1"}), (second, {"b": "1"}), (merge, {"c": "1"})]
    assert history.brought(merge) == 1
    for nowhere in ("9" * 40, merge):
        assert [commit.id for commit in history.commits({merge: nowhere})] == [first, side, merge]


def test_a_commit_that_changes_too_much_says_so(stage: Stage) -> None:
    first = stage.commit({"a": "1"})
    stage.commit({f"file-{number}": "x" for number in range(1500)}, first)
    (_, last) = GitHistory(stage.folder).commits({})
    assert "changes more than 1000 files" in last.problem


def test_a_clone_with_files_is_read_as_well(tmp_path: Path) -> None:
    repository = pygit2.init_repository(str(tmp_path / "clone"), initial_head="main")
    tree = repository.TreeBuilder().write()
    commit = repository.create_commit("refs/heads/main", WHO, WHO, "first\n", tree, [])
    assert [one.id for one in GitHistory(tmp_path / "clone").commits({})] == [str(commit)]
