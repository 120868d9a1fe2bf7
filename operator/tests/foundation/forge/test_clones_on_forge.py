"""The clone on a real forge: a race for main, refusals in words, history, what is not an ordinary file."""

from pathlib import Path

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.forge.adapters.git import GitClone
from tests.stages.forge.installation import Clone, Installation, message, release_files

pytestmark = pytest.mark.toolchain


def clone(installation: Installation, account: str, folder: Path, password: str = "") -> GitClone:
    given = password or installation.passwords[account]
    return GitClone(installation.url, "robotkube/deployment", account, given, folder)


def test_a_race_for_main_has_one_winner(installation: Installation, tmp_path: Path) -> None:
    writer = installation.clone("gate")
    tip = writer.tip()
    plans = [installation.plan(), installation.plan()]
    first, second = (writer.commit(release_files(plan, f"race-{plan[-2:]}"), message(plan), [tip]) for plan in plans)
    clones = [clone(installation, "gate", tmp_path / name) for name in ("one", "two")]
    for pushing, commit in zip(clones, (first, second), strict=True):
        assert pushing.fetch() == tip
        bring(writer, pushing, commit)
    assert clones[0].push_main(first)
    assert clones[0].tip == first
    assert not clones[1].push_main(second)
    assert clones[1].fetch() == first
    assert not clones[1].push_main(second)  # now it knows the winner's commit
    assert clones[0].push_main(first)  # a push that was made already is no error


def bring(source: Clone, target: GitClone, commit: str) -> None:
    """Bring a commit from one clone into another."""
    source.repository.references.create("refs/heads/brought", commit, force=True)
    remote = target._repository.remotes.create_anonymous(source.repository.path)
    remote.fetch(["+refs/heads/brought:refs/test/brought"])


def test_who_may_not_push_is_told_so(installation: Installation, tmp_path: Path) -> None:
    person = installation.clone("operator-team")
    commit = person.commit({"policies/merge.yaml": "x: 1\n"}, "mine\n", [person.tip()])
    clone_of_team = clone(installation, "operator-team", tmp_path)
    clone_of_team.fetch()
    bring(person, clone_of_team, commit)
    with pytest.raises(InputError, match="operator-team must be on the branch's push list"):
        clone_of_team.push_main(commit)


def test_a_wrong_password_ends_at_once(installation: Installation, tmp_path: Path) -> None:
    with pytest.raises(UnavailableError, match="refuses account gate: its password is wrong"):
        clone(installation, "gate", tmp_path, "wrong").fetch()


def test_a_forge_that_is_away_is_unavailable(tmp_path: Path) -> None:
    with pytest.raises(UnavailableError, match=r"git http://127.0.0.1:9/a/b: fetch"):
        GitClone("http://127.0.0.1:9", "a/b", "gate", "x", tmp_path).fetch()


def test_history_and_files(installation: Installation, tmp_path: Path) -> None:
    clone_of_manager = clone(installation, "manager", tmp_path)
    tip = clone_of_manager.fetch()
    history = clone_of_manager.log(None, 1000)
    assert history[0].parents == ()
    assert "README.md" in history[0].changes
    assert history[-1].id == tip
    assert clone_of_manager.log(tip, 10) == []
    assert len(clone_of_manager.log(None, 1)) == 1
    assert clone_of_manager.contains(history[0].id)
    assert clone_of_manager.files(tip, ("nowhere",)) == {}
    assert "policies/initial.yaml" in clone_of_manager.files(tip, ("policies",))
    with pytest.raises(InputError, match="is not here"):
        clone_of_manager.commit("0" * 40)
    with pytest.raises(InputError, match="refs/pull/999/head"):
        clone_of_manager.proposal(999)


def test_links_and_binary_files_are_irregular(installation: Installation, tmp_path: Path) -> None:
    person = installation.clone("operator-team")
    tip = person.tip()
    link = person.commit({"releases/x": "/etc/passwd"}, "link\n", [tip], 0o120000)
    program = person.commit({"releases/y": "echo"}, "program\n", [tip], 0o100755)
    clone_of_team = clone(installation, "operator-team", tmp_path)
    clone_of_team.fetch()
    for commit, path in ((link, "releases/x"), (program, "releases/y")):
        bring(person, clone_of_team, commit)
        assert clone_of_team.commit(commit).irregular == (path,)
        assert path not in clone_of_team.files(commit, ("releases",))
