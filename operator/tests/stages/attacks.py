"""Refusals of attacks, compared with what ci/attacks/table.py says of them.

`shown(place, text, *keys)` in the test that cells name compares their words with `text`, the refusal as it came. A test
that is named by a cell and passes without having shown it fails, after its last parameter has run.
"""

from __future__ import annotations

import os
from collections.abc import Generator

import pytest

from ci.attacks import table
from ci.attacks.cells import Attack, Refused
from ci.attacks.table import attack, refusals

CURRENT = "PYTEST_CURRENT_TEST"
_shown: set[tuple[str, str]] = set()
_named: tuple[tuple[Attack, ...], frozenset[str]] = (), frozenset()


def words_of(key: str, place: str) -> Refused:
    """The refusal of a cell; KeyError when it says none."""
    cell = attack(key).cell(place)
    if not isinstance(cell, Refused):
        raise KeyError(f"attack {key}, {place}: no words of a refusal in ci/attacks/table.py")
    return cell


def shown(place: str, text: str, *keys: str) -> None:
    """The refusal `text` is what the cells of these attacks say, and this is the test that they name."""
    for key in keys:
        cell = words_of(key, place)
        assert cell.pattern.search(text), (
            f"{key}, {place}: ci/attacks/table.py says {cell.words!r}, the refusal {text!r}"
        )
        assert running() == cell.test, f"{key}, {place}: ci/attacks/table.py names {cell.test}, and this is {running()}"
        _shown.add((key, place))


def running() -> str:
    """The test that runs, as cells name it."""
    return name_of(os.environ[CURRENT].rpartition(" ")[0])


def name_of(node: str) -> str:
    """A test's own name, `<file below operator/tests>::<function>`."""
    return node.partition("[")[0].rpartition("tests/")[2]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """The last parameter of a test that cells name fails when one of them was not shown. Of a test of which only some
    parameters were chosen nothing is said."""
    result = yield
    name = name_of(item.nodeid)
    if name not in _tests_named():
        return result
    missing = [(key, place) for key, place, cell in refusals() if cell.test == name and (key, place) not in _shown]
    if missing and item is _last(item.session, name) and not _chosen(item):
        pytest.fail(f"ci/attacks/table.py names this test for {missing}, which it has not shown", pytrace=False)
    return result


def _tests_named() -> frozenset[str]:
    """The tests that cells name, once for all tests of a run: every one of them asks."""
    global _named
    if _named[0] is not table.ATTACKS:
        _named = table.ATTACKS, frozenset(cell.test for _, _, cell in refusals())
    return _named[1]


def _last(session: pytest.Session, name: str) -> pytest.Item:
    return [item for item in session.items if name_of(item.nodeid) == name][-1]


def _chosen(item: pytest.Item) -> bool:
    """Return whether somebody chose parameters or tests by their names."""
    config = item.config
    return bool(config.option.keyword) or any("[" in str(argument) for argument in config.args)
