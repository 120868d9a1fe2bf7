"""`make test` leaves the files of the repository as they were: what is not, is named, and fails a whole run."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from ci.machine import preflight
from ci.test import __main__ as command
from ci.test import groups, working_tree


def git(folder: Path, *words: str) -> None:
    subprocess.run(["git", *words], cwd=folder, check=True, capture_output=True, timeout=30)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository with two files of its own, one that is not added and one that is ignored."""
    folder = tmp_path / "repository"
    (folder / "docs").mkdir(parents=True)
    (folder / "docs" / "page.md").write_text("text\n")
    (folder / "run").write_text("#!/bin/sh\n")
    (folder / ".gitignore").write_text("build/\n")
    git(folder, "init", "--quiet")
    git(folder, "add", ".")
    (folder / "draft.md").write_text("of who writes\n")
    return folder


def nothing(folder: Path) -> None: ...


def edits(folder: Path) -> None:
    (folder / "docs" / "page.md").write_text("TEXT\n")


def restores(folder: Path) -> None:
    """What who writes has not added yet is lost."""
    (folder / "draft.md").write_text("")


def adds(folder: Path) -> None:
    (folder / "docs" / "results.json").write_text("{}")


def removes(folder: Path) -> None:
    (folder / "docs" / "page.md").unlink()
    (folder / "docs").rmdir()


def makes_a_program(folder: Path) -> None:
    (folder / "run").chmod(0o755)


def links(folder: Path) -> None:
    (folder / "run").unlink()
    (folder / "run").symlink_to("docs/page.md")


def clones(folder: Path) -> None:
    git(folder, "clone", "--quiet", "--no-hardlinks", ".", "clone")


def adds_by_another_name(folder: Path) -> None:
    (folder / "docs" / "a\udcff").write_text("")


def ignored(folder: Path) -> None:
    (folder / "build").mkdir()
    (folder / "build" / "report.json").write_text("{}")


def commits(folder: Path) -> None:
    git(folder, "add", ".")
    git(folder, "-c", "user.name=a", "-c", "user.email=a@example.org", "commit", "--quiet", "--message=all")


@pytest.mark.parametrize("act", [nothing, ignored, commits])
def test_files_that_are_as_they_were_are_no_difference(repository: Path, act: Callable[[Path], None]) -> None:
    before = working_tree.read(repository)
    assert len(before.digests) == 4
    act(repository)
    assert working_tree.difference(before, working_tree.read(repository)) == ""


@pytest.mark.parametrize(
    ("act", "became"),
    [
        (edits, "docs/page.md was changed"),
        (removes, "docs/page.md was removed"),
        (makes_a_program, "run was changed"),
        (links, "run was changed"),
    ],
)
def test_a_file_that_is_not_as_it_was_is_named(repository: Path, act: Callable[[Path], None], became: str) -> None:
    before = working_tree.read(repository)
    act(repository)
    after = working_tree.read(repository)
    assert working_tree.difference(before, after) == f"{became} while the tests ran; {working_tree.REMEDY}"
    assert working_tree.difference_of_others(before, after) == ""


@pytest.mark.parametrize(
    ("act", "became"),
    [
        (restores, "draft.md was changed"),
        (adds, "docs/results.json was made"),
        (clones, "clone/ was made"),
        (adds_by_another_name, "docs/a\\udcff was made"),
    ],
)
def test_files_that_git_did_not_have_are_named_apart(
    repository: Path, act: Callable[[Path], None], became: str
) -> None:
    before = working_tree.read(repository)
    act(repository)
    after = working_tree.read(repository)
    assert working_tree.difference_of_others(before, after) == f"{became} while the tests ran; {working_tree.REMEDY}"
    assert working_tree.difference(before, after) == ""


def test_of_many_files_the_first_are_named(repository: Path) -> None:
    before = working_tree.read(repository)
    for number in range(working_tree.NAMED_MAX + 3):
        (repository / f"{number:02}").touch()
    said = working_tree.difference_of_others(before, working_tree.read(repository))
    assert said.startswith("00 was made, 01 was made, ")
    assert "19 was made, and 3 more while the tests ran; " in said


@pytest.fixture
def run(repository: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """`make test` in the repository, with a group that acts on its files instead of running tests."""

    def run(act: Callable[[Path], None], *words: str) -> int:
        def run_all(chosen: list[groups.Group], _: object, finished: list[groups.Result]) -> None:
            act(repository)
            finished += [groups.Result(group, 1, 0, 0, 1.0) for group in chosen]

        monkeypatch.setattr(command, "TOP", repository)
        monkeypatch.setattr(command, "run_all", run_all)
        monkeypatch.setattr(preflight, "require", lambda: None)
        monkeypatch.setattr(sys, "argv", ["make test", *words])
        return command.main()

    return run


@pytest.mark.parametrize("tier", [(), ("--thorough",)])
def test_a_whole_run_during_which_a_file_changed_has_failed(
    run: Callable[..., int], tier: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(nothing, *tier) == 0
    assert "failed: " not in capsys.readouterr().out
    assert run(edits, *tier) == 1
    lines = capsys.readouterr().out.splitlines()
    why = f"docs/page.md was changed while the tests ran; {working_tree.REMEDY}"
    assert f"failed: files of the repository: {why}" in lines
    assert lines[-1].endswith(" passed, 1 failed, 0 skipped")


def test_a_new_file_is_named_and_fails_nothing(run: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> None:
    """Who runs the tests may keep what they print beside them."""
    assert run(adds) == 0
    assert "not counted as a failure: docs/results.json was made while the tests ran;" in capsys.readouterr().out


@pytest.mark.parametrize("words", [("--fast",), ("--only", "check"), ("operator/tests/ci",)])
def test_who_runs_some_tests_may_write_meanwhile(
    run: Callable[..., int], words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(edits, *words) == 0
    printed = capsys.readouterr().out
    assert "not counted as a failure: docs/page.md was changed while the tests ran; a test that writes" in printed


def test_what_is_no_checkout_is_not_compared(
    run: Callable[..., int], repository: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (repository / ".git").rename(repository.parent / "elsewhere")
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(repository.parent))
    assert run(edits) == 0
    printed = capsys.readouterr().out
    assert "no file was compared with what it was before the tests: it is no git checkout (fatal: not a git" in printed


def test_without_git_no_file_is_compared(
    run: Callable[..., int], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert run(edits) == 0
    assert "before the tests: git cannot be asked for its files: [Errno 2]" in capsys.readouterr().out


def test_a_run_that_takes_the_checkout_away_has_failed(
    run: Callable[..., int], repository: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(repository.parent))
    assert run(lambda folder: (folder / ".git").rename(folder.parent / "elsewhere")) == 1
    assert "git named 4 files before the tests, and none since: it is no git checkout" in capsys.readouterr().out
