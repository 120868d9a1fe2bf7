"""The page of design principles names the ten rows of Table I with the stories of their tests."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ci import principles

DOCSTRING = '"""A principle.\n\nExample: it\nis so.\n\nStory: it was tried.\n"""\n'


def test_the_page_names_exactly_the_ten_rows() -> None:
    text = principles.PAGE.read_text(encoding="utf-8")
    assert re.findall(r"^## (\w+)$", text, re.MULTILINE) == list(principles.NAMES)


def test_the_page_tells_the_stories_of_the_tests() -> None:
    text = principles.PAGE.read_text(encoding="utf-8")
    for one in principles.read_principles():
        assert one.principle in text, "run: make reference"
        assert one.example in text, "run: make reference"
        assert one.story in text, "run: make reference"


def test_results_stand_beside_their_rows() -> None:
    rows = principles.read_principles()
    text = principles.page(rows, {"p01": "passed", "p02": "failed", "p03": "skipped"})
    said = re.findall(r"^\| \[(p\d\d)\].*\| ([a-z ]+) \|$", text, re.MULTILINE)
    assert said[:4] == [("p01", "holds"), ("p02", "does not hold"), ("p03", "not tried"), ("p04", "not tried")]
    assert len(said) == 10


def ten(folder: Path) -> Path:
    for name in principles.NAMES:
        (folder / f"test_{name}.py").write_text(DOCSTRING)
    return folder


def test_a_row_too_few_or_too_many_is_refused(tmp_path: Path) -> None:
    folder = ten(tmp_path)
    assert principles.read_principles(folder)[0] == principles.Principle(
        "p01", "A principle.", "it is so.", "it was tried."
    )
    (folder / "test_p11.py").write_text(DOCSTRING)
    with pytest.raises(ValueError, match=r"exactly p01, .*; it holds .*p11"):
        principles.read_principles(folder)
    (folder / "test_p11.py").unlink()
    (folder / "test_p10.py").unlink()
    with pytest.raises(ValueError, match="exactly p01"):
        principles.read_principles(folder)


def test_a_story_without_its_paragraphs_is_refused(tmp_path: Path) -> None:
    folder = ten(tmp_path)
    (folder / "test_p04.py").write_text('"""A principle."""\n')
    with pytest.raises(ValueError, match=r"test_p04\.py: its docstring must be the principle"):
        principles.read_principles(folder)
