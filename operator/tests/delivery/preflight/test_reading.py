"""Facts are read at the same time and until a deadline; what rests on another says why that was not read."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from robotkube.delivery.preflight.adapters.calls_at_once import AT_ONCE, at_once
from robotkube.delivery.preflight.core.findings import Unread
from robotkube.delivery.preflight.loops.reading import FactReading
from robotkube.errors import InputError


def refuse(words: str) -> Any:
    raise InputError(words)


def test_facts_that_rest_on_others() -> None:
    readers = {
        "sum": lambda facts: facts.needed("one") + facts.needed("two"),
        "one": lambda _: 1,
        "two": lambda facts: facts.needed("one") + 1,
    }
    assert FactReading(readers, 10).facts() == {"sum": 3, "one": 1, "two": 2}


def test_why_one_was_not_read_goes_on_to_what_rests_on_it() -> None:
    readers = {"nodes": lambda _: refuse("403 nodes is forbidden"), "groups": lambda facts: facts.needed("nodes")}
    assert FactReading(readers, 10).facts() == dict.fromkeys(readers, Unread("403 nodes is forbidden"))


def test_one_that_hangs_is_given_up_at_the_deadline() -> None:
    going_on = threading.Event()
    reading = FactReading({"slow": lambda _: going_on.wait(10), "quick": lambda _: 1}, 0.2)
    facts = reading.facts()
    going_on.set()
    assert facts == {"slow": Unread("timed out: slow was not read within 0.2 s"), "quick": 1}
    assert reading.left() == 0


def test_a_mistake_of_the_program_is_not_hidden() -> None:
    with pytest.raises(ZeroDivisionError):
        FactReading({"broken": lambda _: 1 // 0}, 10).facts()


def test_calls_keep_their_order_and_their_first_error() -> None:
    assert at_once([lambda number=number: number for number in range(3 * AT_ONCE)]) == list(range(3 * AT_ONCE))
    with pytest.raises(InputError, match="second"):
        at_once([lambda: 1, lambda: refuse("second"), lambda: refuse("third")])
    assert at_once([]) == []
