"""Commits of the manager in a real repository: exactly the wanted files change, nothing else, and nothing is moved."""

from __future__ import annotations

from pathlib import Path

import pygit2
import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter

FILES = {"README.md": "r\n", "releases/a/x.yaml": "1\n", "releases/b/y.yaml": "2\n", "sources/a/s.yaml": "3\n"}


@pytest.fixture
def origin(tmp_path: Path) -> pygit2.Repository:
    """A repository with one commit on main."""
    repository = pygit2.init_repository(
        str(tmp_path / "origin" / "o" / "deployment.git"), bare=True, initial_head="main"
    )
    index = pygit2.Index()
    for path, text in FILES.items():
        index.add(pygit2.IndexEntry(path, repository.create_blob(text.encode()), pygit2.enums.FileMode.BLOB))
    who = pygit2.Signature("seed", "seed@x.invalid", 1, 0)
    repository.create_commit("refs/heads/main", who, who, "seed", index.write_tree(repository), [])
    return repository


@pytest.fixture
def clone(origin: pygit2.Repository, tmp_path: Path) -> GitClone:
    made = GitClone(f"file://{tmp_path}/origin", "o/deployment", "manager", "x", tmp_path / "clone")
    made.fetch()
    return made


@pytest.fixture
def writer(clone: GitClone, tmp_path: Path) -> ProposalWriter:
    return ProposalWriter(tmp_path / "clone", "manager", "x", "robotkube-manager", lambda: 1795250000.5)


def test_a_commit_changes_exactly_what_it_names(clone: GitClone, writer: ProposalWriter) -> None:
    changes = {"releases/a/x.yaml": "new\n", "releases/b/y.yaml": None, "sources/c/d/e.yaml": "deep\n"}
    made = writer.commit(clone.tip, changes, "deploy(x): y\n")
    commit = clone.commit(made)
    assert commit.changes == changes
    assert (commit.parents, commit.message, commit.author) == ((clone.tip,), "deploy(x): y\n", "robotkube-manager")
    assert clone.files(made, ["releases", "sources"]) == {
        "releases/a/x.yaml": "new\n",
        "sources/a/s.yaml": "3\n",
        "sources/c/d/e.yaml": "deep\n",
    }
    assert not clone.contains(made)
    assert writer.commit(clone.tip, changes, "deploy(x): y\n") == made


def test_everything_may_go(clone: GitClone, writer: ProposalWriter) -> None:
    made = writer.commit(clone.tip, dict.fromkeys(FILES), "withdraw(x): y\n")
    assert clone.files(made, ["releases", "sources"]) == {}


def test_what_is_not_there_can_be_removed(clone: GitClone, writer: ProposalWriter) -> None:
    made = writer.commit(clone.tip, {"releases/z/z.yaml": None, "releases/a/x.yaml": "2\n"}, "m\n")
    assert clone.commit(made).changes == {"releases/a/x.yaml": "2\n"}


def test_an_unknown_parent_is_an_error(writer: ProposalWriter) -> None:
    with pytest.raises(InputError, match="fetch first"):
        writer.commit("0" * 40, {}, "m")


def test_a_forge_that_is_away(clone: GitClone, writer: ProposalWriter, tmp_path: Path) -> None:
    made = writer.commit(clone.tip, {"releases/a/x.yaml": "2\n"}, "m\n")
    (tmp_path / "origin").rename(tmp_path / "gone")
    with pytest.raises(UnavailableError, match="proposal p1"):
        writer.propose(made, "p1", "t", "b")


def test_without_agit_a_proposal_is_a_branch_and_the_forge_is_asked_for_its_pull_request(
    origin: pygit2.Repository, clone: GitClone, tmp_path: Path
) -> None:
    asked: list[tuple[str, str, str]] = []

    def opened(branch: str, title: str, body: str) -> int:
        asked.append((branch, title, body))
        return 7

    writer = ProposalWriter(tmp_path / "clone", "manager", "x", "m", lambda: 1.0, open_pull_request=opened)
    main = clone.tip
    for text in ("one\n", "two\n"):  # the second as after a restart: the same topic with another commit
        made = writer.commit(main, {"releases/a/x.yaml": text}, "deploy(x): y\n")
        assert writer.propose(made, "20261121-100000-abcdef", "title", "body") == 7
        assert str(origin.references["refs/heads/robotkube/20261121-100000-abcdef"].target) == made
    assert asked == [("robotkube/20261121-100000-abcdef", "title", "body")] * 2
    assert str(origin.references["refs/heads/main"].target) == main


def test_the_head_of_a_pull_request_stands_where_the_forge_keeps_it(origin: pygit2.Repository, tmp_path: Path) -> None:
    head = origin.references["refs/heads/main"].target
    origin.references.create("refs/merge-requests/7/head", head)
    heads = "refs/merge-requests/{}/head"
    clone = GitClone(f"file://{tmp_path}/origin", "o/deployment", "gate", "x", tmp_path / "gate", heads=heads)
    assert clone.proposal(7).id == str(head)
    with pytest.raises(InputError, match="refs/merge-requests/8/head is not there"):
        clone.proposal(8)
