"""The table of attacks says what tests show, and nothing else."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ci.attacks import cells, table
from ci.attacks.cells import Refused, Unseen
from ci.attacks.table import ATTACKS, refusals
from ci.reference import attacks as attack_reference
from tests.stages import attacks as stage
from tests.stages.paths import REPOSITORY

TESTS = REPOSITORY / "operator" / "tests"
ASKED_FOR = {  # by the issue: seen to work, and known failures of peers
    *("image-by-manager", "image-by-publisher", "runs-by-itself", "merge-against-the-gate", "application-by-argocd"),
    *("pod-by-administrator", "sidecar", "annotation", "key-read", "repo-server-asked", "hook-unsigned"),
    *("staged-tag-overwritten", "platform-image-pushed", "notes-pushed", "slow-connections", "deep-json"),
    *("ephemeral-container", "verdict-overwritten", "verifier-off", "tag-moves", "static-pod", "policy-deleted"),
    "image-volume",
}
IMPORT = "from tests.stages.attacks import shown"
Shown = tuple[str, str, str]
"""Test, place and key of a call of `shown`."""


def calls(path: Path) -> Iterator[Shown]:
    """The calls of `shown` in the functions of a module, whose places and keys are written out."""
    name = path.relative_to(TESTS).as_posix()
    if IMPORT not in path.read_text(encoding="utf-8"):
        return
    for function in ast.parse(path.read_text(encoding="utf-8")).body:
        if not isinstance(function, ast.FunctionDef):
            continue
        for call in ast.walk(function):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "shown":
                place, *keys = [one.value for one in (call.args[0], *call.args[2:]) if isinstance(one, ast.Constant)]
                yield from ((f"{name}::{function.name}", str(place), str(key)) for key in keys)


def all_calls() -> set[Shown]:
    return {call for path in sorted(TESTS.rglob("test_*.py")) if path != Path(__file__) for call in calls(path)}


def test_every_refusal_is_shown_by_the_test_that_its_cell_names() -> None:
    """And no test shows one that no cell names it for."""
    assert all_calls() == {(cell.test, place, key) for key, place, cell in refusals()}


def test_what_was_asked_for_is_there_and_each_attack_once() -> None:
    keys = [one.key for one in ATTACKS]
    assert len(set(keys)) == len(keys) >= 20
    assert set(keys) >= ASKED_FOR
    assert len({one.sentence for one in ATTACKS}) == len(keys)


def test_every_cell_says_something() -> None:
    for one in ATTACKS:
        for place in cells.PLACES:
            cell = one.cell(place)
            assert place == "elsewhere" or cell is not None
            assert not isinstance(cell, Unseen) or cell.why
            assert not isinstance(cell, Refused) or len(cell.words) > 10


def test_the_page_has_the_table() -> None:
    page = attack_reference.PAGE.read_text(encoding="utf-8")
    assert attack_reference.rewritten(page) == page, "run: make reference"


def test_an_attack_or_a_place_that_nobody_knows_is_a_mistake() -> None:
    with pytest.raises(KeyError):
        table.attack("none")
    with pytest.raises(KeyError, match="selection, gate, admission, nodes, elsewhere"):
        ATTACKS[0].cell("nowhere")
    with pytest.raises(KeyError, match="image-by-manager, selection: no words"):
        stage.words_of("image-by-manager", "selection")


def test_words_with_gaps_are_found_in_a_refusal_and_others_are_not() -> None:
    cell = Refused("image … may not run in namespace …: only (these)", "a::b")
    assert cell.pattern.search("denied: image a/b@c may not run in namespace x: only (these) images")
    assert not cell.pattern.search("image a may run in namespace x: only (these)")
    assert not cell.pattern.search("only these")


@pytest.fixture
def named(monkeypatch: pytest.MonkeyPatch) -> str:
    """One attack whose one refusal names the test `tests/a/test_b.py::test_c`."""
    cell = Refused("it … refused", "a/test_b.py::test_c")
    one = cells.Attack("only", "One", Unseen("x"), cell, Unseen("x"), Unseen("x"))
    monkeypatch.setattr(table, "ATTACKS", (one,))
    monkeypatch.setattr(stage, "_shown", set())
    return "operator/tests/a/test_b.py::test_c"


def test_a_refusal_counts_in_the_test_that_is_named_and_with_its_words(
    named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(stage.CURRENT, f"{named}[one two] (call)")
    stage.shown("gate", "it was refused", "only")
    with pytest.raises(AssertionError, match="says 'it … refused', the refusal 'it was taken'"):
        stage.shown("gate", "it was taken", "only")
    monkeypatch.setenv(stage.CURRENT, f"{named}_other (call)")
    with pytest.raises(AssertionError, match=r"names a/test_b\.py::test_c, and this is a/test_b\.py::test_c_other"):
        stage.shown("gate", "it was refused", "only")


def item(node: str, session: Any, keyword: str = "", *arguments: str) -> Any:
    config = SimpleNamespace(option=SimpleNamespace(keyword=keyword), args=list(arguments))
    return SimpleNamespace(nodeid=node, session=session, config=config)


def passes(one: Any) -> None:
    """Let an item pass."""
    running = stage.pytest_runtest_call(one)
    next(running)
    with pytest.raises(StopIteration):
        running.send(None)


def test_a_named_test_that_shows_nothing_fails_with_its_last_parameter(
    named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = SimpleNamespace(items=[])
    first, last, other = (item(node, session) for node in (f"{named}[1]", f"{named}[2]", f"{named}_d"))
    session.items = [first, last, other]
    for one in (first, other):
        passes(one)
    with pytest.raises(pytest.fail.Exception, match=r"names this test for \[\('only', 'gate'\)\]"):
        passes(last)
    passes(item(f"{named}[2]", SimpleNamespace(items=[last]), "2"))  # somebody chose
    passes(item(f"{named}[2]", SimpleNamespace(items=[last]), "", f"{named}[2]"))
    monkeypatch.setenv(stage.CURRENT, f"{named}[2] (call)")
    stage.shown("gate", "it was refused", "only")
    passes(last)
