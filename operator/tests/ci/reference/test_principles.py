"""The page of design principles names the ten rows of Table I with the stories of their tests."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest

from ci.reference import principles
from ci.test import __main__ as command
from ci.test import groups

DOCSTRING = '"""A principle.\n\nExample: it\nis so.\n\nStory: it was tried.\n\nAsserted: on messages.\n"""\n'


def test_the_page_names_exactly_the_ten_rows() -> None:
    text = principles.PAGE.read_text(encoding="utf-8")
    assert re.findall(r"^## (\w+)$", text, re.MULTILINE) == list(principles.NAMES)


def test_the_page_is_made_of_the_stories_of_the_tests_and_of_its_results() -> None:
    text = principles.PAGE.read_text(encoding="utf-8")
    assert text == principles.page(principles.read_principles(), principles.results_of(text)), "run: make reference"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A page that says that p01 and p02 hold, and results of no run yet."""
    monkeypatch.setattr(principles, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(principles, "RESULTS", tmp_path / "results.json")
    monkeypatch.setattr(principles, "read_results", partial(principles.read_results, tmp_path / "results.json"))
    rows = principles.read_principles()
    (tmp_path / "page.md").write_text(principles.page(rows, {"p01": "passed", "p02": "passed"}), encoding="utf-8")
    return tmp_path


def test_writing_the_page_keeps_what_is_known_of_stories_that_did_not_run(place: Path) -> None:
    before = principles.PAGE.read_text()
    assert principles.write().read_text() == before
    principles.RESULTS.write_text('{"p02": "failed", "p03": "passed", "p01": "skipped"}')
    assert principles.results_of(principles.write().read_text()) == {"p01": "passed", "p02": "failed", "p03": "passed"}


def test_news_are_what_the_page_does_not_say_yet_and_change_nothing(place: Path) -> None:
    before = principles.PAGE.read_bytes()
    assert principles.differences() == ""
    principles.RESULTS.write_text('{"p01": "passed", "p02": "failed", "p03": "passed", "p04": "skipped"}')
    assert principles.differences() == "p02 does not hold, p03 holds"
    assert principles.PAGE.read_bytes() == before


def test_results_stand_beside_their_rows() -> None:
    rows = principles.read_principles()
    text = principles.page(rows, {"p01": "passed", "p02": "failed", "p03": "skipped"})
    said = re.findall(r"^\| \[(p\d\d)\].*\| ([a-z ]+) \|$", text, re.MULTILINE)
    assert said[:4] == [("p01", "holds"), ("p02", "does not hold"), ("p03", "not tried"), ("p04", "not tried")]
    assert len(said) == 10


def test_a_run_of_the_tests_leaves_the_page_as_it_is(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(group: groups.Group, places: Sequence[str], output: Path | None = None) -> groups.Result:
        principles.RESULTS.write_text('{"p02": "failed"}')
        return groups.Result(group, 1, 0, 0, 1.0)

    before = principles.PAGE.read_bytes()
    monkeypatch.setattr(groups, "run", run)
    monkeypatch.setattr(command.preflight, "require", lambda: None)
    monkeypatch.setattr(groups.preparing, "prepare", lambda needs: None)
    monkeypatch.setattr(sys, "argv", ["make test", "--only", "platform"])
    assert command.main() == 0
    assert principles.PAGE.read_bytes() == before
    assert "Table I is not what its page states (p02 does not hold): `make reference`" in capsys.readouterr().out


def ten(folder: Path) -> Path:
    for name in principles.NAMES:
        (folder / f"test_{name}.py").write_text(DOCSTRING)
    return folder


def test_a_row_too_few_or_too_many_is_refused(tmp_path: Path) -> None:
    folder = ten(tmp_path)
    assert principles.read_principles(folder)[0] == principles.Principle(
        "p01", "A principle.", "it is so.", "it was tried.", "on messages."
    )
    (folder / "test_p11.py").write_text(DOCSTRING)
    with pytest.raises(ValueError, match=r"exactly p01, .*; it holds .*p11"):
        principles.read_principles(folder)
    (folder / "test_p11.py").unlink()
    (folder / "test_p10.py").unlink()
    with pytest.raises(ValueError, match="exactly p01"):
        principles.read_principles(folder)


@pytest.mark.parametrize("docstring", ['"""A principle."""\n', DOCSTRING.replace("Asserted: ", "")])
def test_a_story_without_its_paragraphs_is_refused(tmp_path: Path, docstring: str) -> None:
    folder = ten(tmp_path)
    (folder / "test_p04.py").write_text(docstring)
    with pytest.raises(
        ValueError, match=r"test_p04\.py: its docstring must be the principle and paragraphs with Example: , "
    ):
        principles.read_principles(folder)
