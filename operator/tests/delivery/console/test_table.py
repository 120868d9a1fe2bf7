"""The table: who resumes after any version has what is there, and nothing twice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.console.core.table import AGENTS, TASKS, ItemTable, TableChange, resume_id, resumed_version

KEYS = ("a", "b", "c", "d")
WRITES = st.tuples(st.sampled_from((AGENTS, TASKS)), st.sampled_from(KEYS), st.none() | st.integers(0, 2))
READS = st.integers(0, 2)  # which reader asks now


class Reader:
    """A page: it has what it was told, and asks for what came after it."""

    def __init__(self) -> None:
        self.version = 0
        self.items: dict[tuple[str, str], str] = {}
        self.resyncs = 0

    def ask(self, table: ItemTable) -> TableChange:
        """Ask and take the answer; a snapshot where the table cannot tell."""
        change = table.since(self.version)
        if change is None:
            self.resyncs += 1
            self.items.clear()
            change = table.whole()
        for kind, key in pairs(change.gone):
            self.items.pop((kind, key), None)
        for kind, items in change.items.items():
            self.items |= {(kind, key): text for key, text in items.items()}
        self.version = change.version
        return change


def pairs(keys: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, str]]:
    return ((kind, key) for kind, names in keys.items() for key in names)


def write(table: ItemTable, kind: str, key: str, value: int | None) -> None:
    if value is None:
        table.remove(kind, key)
    else:
        table.put(kind, key, {"value": value})


def contents(table: ItemTable) -> dict[tuple[str, str], str]:
    return {(kind, key): text for kind, items in table.whole().items.items() for key, text in items.items()}


@given(st.lists(WRITES | READS, max_size=60), st.integers(1, 6))
def test_whoever_asks_whenever_has_the_table(steps: list[Any], gone_max: int) -> None:
    table = ItemTable(gone_max)
    readers = [Reader(), Reader(), Reader()]
    for step in steps:
        if isinstance(step, tuple):
            write(table, *step)
        else:
            readers[step].ask(table)
            assert readers[step].items == contents(table)
    for reader in readers:
        reader.ask(table)
        assert reader.items == contents(table)
        assert not reader.ask(table), "nothing happened since, and something was told"


@given(st.lists(WRITES, max_size=60), st.integers(0, 60))
def test_a_change_has_each_item_once_and_only_what_changed(writes: list[Any], version: int) -> None:
    table = ItemTable()
    expected: set[tuple[str, str]] = set()
    for one in writes:
        before = table.version
        write(table, *one)
        if table.version > before >= version:
            expected.add(one[:2])
    change = table.since(min(version, table.version))
    assert change is not None
    keys = [*((kind, key) for kind, items in change.items.items() for key in items), *pairs(change.gone)]
    assert sorted(keys) == sorted(expected)


def test_the_same_document_again_is_no_change() -> None:
    table = ItemTable()
    assert table.put(AGENTS, "a", {"x": 1})
    assert not table.put(AGENTS, "a", {"x": 1})
    assert not table.remove(AGENTS, "b")
    assert table.version == 1


def test_a_version_that_was_never_reached_is_not_resumed() -> None:
    """After a restart with the same epoch there would be no other way to see it."""
    assert ItemTable().since(1) is None


def test_who_is_older_than_what_is_remembered_of_gone_items_reads_anew() -> None:
    table = ItemTable(gone_max=1)
    for key in KEYS[:3]:
        table.put(AGENTS, key, {})
    table.remove(AGENTS, "a")
    change = table.since(3)
    assert change is not None
    assert change.gone == {AGENTS: ("a",)}
    table.remove(AGENTS, "b")
    assert table.since(3) is None
    change = table.since(4)
    assert change is not None
    assert change.gone == {AGENTS: ("b",)}


@pytest.mark.parametrize("text", ["", "e", "f.3", "e.", "e.x", "e.-1", "e.3.4", f"e.{'9' * 20}", "e.٣"])
def test_what_is_no_id_of_this_epoch(text: str) -> None:
    assert resumed_version(text, "e") is None


def test_an_id_is_read_back() -> None:
    assert resumed_version(resume_id("e", 12), "e") == 12
