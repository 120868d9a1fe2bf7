"""Objects from one clone to another without a forge: what goes, what is taken in, and what is not."""

from dataclasses import replace
from pathlib import Path

import pygit2
import pytest
from pygit2.enums import FileMode

from robotkube.delivery.gate.loops.pending_objects import KEPT_MAX, PendingObjects
from robotkube.errors import DocumentError
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from robotkube.foundation.forge.adapters.git import commit_objects as git_objects
from robotkube.foundation.forge.core import commit_objects as handed_objects
from robotkube.foundation.forge.core.commit_objects import CommitObjects, object_id, read_objects, write_objects

AUTHOR = pygit2.Signature("somebody", "somebody@example", 1_795_000_000, 0)
REPOSITORY = "robotkube/deployment"
FILES = {"README.md": "deployment\n", "releases/a/one.yaml": "1\n", "releases/b/two.yaml": "2\n"}


class Stage:
    """A manager's clone and the gate's, whose main stands at the same commit."""

    def __init__(self, folder: Path) -> None:
        self.gate = GitClone("http://forge.example", REPOSITORY, "gate", "word", folder / "gate")
        self.source = pygit2.init_repository(str(folder / "manager"), bare=True)
        self.target = pygit2.Repository(str(folder / "gate"))
        self.writer = ProposalWriter(folder / "manager", "manager", "word", "manager", lambda: 1_795_000_000.0)
        empty = self.source.TreeBuilder().write()
        root = str(self.source.create_commit(None, AUTHOR, AUTHOR, "root\n", empty, []))
        self.tip = self.writer.commit(root, FILES, "seed\n")
        for identifier in self.source:
            self.target.odb.write(*self.source.odb.read(identifier))
        self.gate.moved_to(self.tip)

    def objects_of(self, commit: str) -> CommitObjects:
        new = git_objects.new_objects(self.source, self.source[commit])
        assert new is not None
        return read_objects(write_objects(new, REPOSITORY), REPOSITORY)


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path)


def test_only_what_is_new_goes_and_is_taken_in(stage: Stage) -> None:
    changes = {"releases/a/one.yaml": "new\n", "releases/b/two.yaml": None, "sources/c.yaml": "3\n"}
    commit = stage.writer.commit(stage.tip, changes, "a plan\n")
    objects = stage.objects_of(commit)
    assert [kind for kind, _ in objects.objects] == ["commit", "tree", "tree", "tree", "blob", "tree", "blob"]
    received = stage.gate.receive(objects)
    assert received is not None
    assert (received.id, received.parents, received.changes) == (commit, (stage.tip,), changes)


def test_what_is_missing_or_no_object_of_its_kind_is_not_taken(stage: Stage, tmp_path: Path) -> None:
    objects = stage.objects_of(stage.writer.commit(stage.tip, {"releases/c/d/three.yaml": "3\n"}, "a plan\n"))
    for missing in objects.objects[1:]:
        rest = tuple(one for one in objects.objects if one != missing)
        assert Stage(tmp_path / object_id(*missing)).gate.receive(replace(objects, objects=rest)) is None, missing[0]
    torn = b"100644 a\0too short"
    commit = b"tree %s\nparent %s\nauthor a <a> 1 +0000\ncommitter a <a> 1 +0000\n\nx\n"
    commit %= (object_id("tree", torn).encode(), stage.tip.encode())
    wrong = CommitObjects(object_id("commit", commit), (("commit", commit), ("tree", torn)))
    assert stage.gate.receive(wrong) is None
    assert wrong.commit not in stage.target, "a commit that is here is not fetched, nor what it lacks"
    assert stage.gate.receive(CommitObjects(object_id("commit", b"x"), (("commit", b"x"),))) is None
    assert stage.gate.receive(objects) is not None


def test_a_commit_on_something_else_than_mains_tip_is_not_taken(stage: Stage) -> None:
    first = stage.writer.commit(stage.tip, {"releases/c.yaml": "3\n"}, "first\n")
    second = stage.writer.commit(first, {"releases/d.yaml": "4\n"}, "second\n")
    merge = stage.writer.commit(stage.tip, {"releases/e.yaml": "5\n"}, "merge\n", merged=first)
    for commit in (second, merge):
        objects = stage.objects_of(commit)
        assert stage.gate.receive(objects) is None
        assert all(object_id(*one) not in stage.target for one in objects.objects if one[0] == "blob")


def test_a_link_to_another_repository_is_not_taken(stage: Stage) -> None:
    builder = stage.source.TreeBuilder(stage.source[stage.tip].tree)
    builder.insert("elsewhere", pygit2.Oid(hex="1" * 40), FileMode.COMMIT)
    commit = stage.source.create_commit(None, AUTHOR, AUTHOR, "link\n", builder.write(), [stage.tip])
    whole = [("commit", stage.source.odb.read(commit)[1]), ("tree", stage.source.odb.read(builder.write())[1])]
    assert stage.gate.receive(CommitObjects(str(commit), tuple(whole))) is None


def test_too_much_is_not_handed_over(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    big = stage.writer.commit(stage.tip, {"releases/big.yaml": "x" * handed_objects.BYTES_MAX}, "big\n")
    assert git_objects.new_objects(stage.source, stage.source[big]) is None
    monkeypatch.setattr(git_objects, "OBJECTS_MAX", 3)
    many = stage.writer.commit(stage.tip, {f"releases/{i}.yaml": f"{i}\n" for i in range(3)}, "many\n")
    assert git_objects.new_objects(stage.source, stage.source[many]) is None


def test_files_of_single_objects_become_a_pack(stage: Stage, tmp_path: Path) -> None:
    commit = stage.writer.commit(stage.tip, {"releases/c.yaml": "3\n"}, "a plan\n")
    assert stage.gate.receive(stage.objects_of(commit)) is not None
    git_objects.pack_loose(stage.gate._repository)
    assert list((tmp_path / "gate" / "objects").glob("??/*")) == []
    assert stage.gate.commit(commit).changes == {"releases/c.yaml": "3\n"}
    again = stage.writer.commit(stage.tip, {"releases/c.yaml": "3\n"}, "the same files\n")
    assert stage.gate.receive(stage.objects_of(again)) is not None


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (b"{", "the body is not readable as JSON"),
        (b"[]", "the body must be a JSON object"),
        (b"{}", "objects: must be a list of 1 to 1000 objects"),
        (b'{"objects": [1]}', "objects[0].kind: must be one of commit, tree, blob"),
        (b'{"objects": [{"kind": "blob", "content": "?"}]}', "objects[0].content: must be text in base64"),
        (b'{"objects": [{"kind": "blob", "content": 7}]}', "objects[0].content: must be text in base64"),
        (b'{"repository": "a/b", "objects": [{"kind": "blob", "content": ""}]}', f"repository: must be {REPOSITORY}"),
        (write_objects(CommitObjects("0" * 40, (("blob", b""),)), REPOSITORY), "commit: must be the id of one"),
        (write_objects(CommitObjects("", (("blob", bytes(2**20 + 1)),)), REPOSITORY), "more than 1048576 bytes"),
        (write_objects(CommitObjects("", (("blob", b""),) * 1001), REPOSITORY), "1 to 1000 objects"),
    ],
)
def test_what_cannot_be_read_is_refused_in_words(body: bytes, problem: str) -> None:
    with pytest.raises(DocumentError) as refusal:
        read_objects(body, REPOSITORY)
    assert any(problem in sentence for sentence in refusal.value.problems), refusal.value.problems


def test_the_gate_keeps_a_bounded_number_of_each_and_gives_it_its_own_once() -> None:
    kept = PendingObjects()
    first = CommitObjects("1", ())
    kept.keep("north", first)
    for number in range(KEPT_MAX + 1):
        kept.keep("south", CommitObjects(str(number), ()))
    assert kept.pop("south", "0") is None
    assert [kept.pop(account, "1") for account in ("south", "south", "north", "west")] == [first, None, first, None]
