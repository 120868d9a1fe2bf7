"""What `make bench` measures and says of decisions; times themselves are judged by nobody here."""

from __future__ import annotations

import importlib
from importlib.util import find_spec

import pytest

from benchmarks.delivery import application_manager, decisions
from benchmarks.delivery.application_manager import checkout, compare_revisions, decision_record, known, together
from benchmarks.measuring.comparisons import Quantiles
from ci.errors import SetUpError
from ci.folders import PROJECT

pytestmark = pytest.mark.processes

FAST, SLOW = Quantiles(100, 2.0, 3.0, 4.0), Quantiles(100, 3.0, 4.0, 6.0)
OURS = {"still": FAST, "moving": SLOW, "reading": FAST}


def test_a_checkout_is_measured_in_a_process_of_its_own() -> None:
    measured = application_manager.decisions(PROJECT, 2)
    assert {name: len(values) for name, values in measured.items()} == {"still": 2, "moving": 2, "reading": 2}
    assert all(value > 0 for values in measured.values() for value in values)


def test_main_moves_with_each_decision() -> None:
    class Validating:
        def validate(self, *asked: object) -> list[str]:
            return []

    manager = decisions.Manager(Validating())
    tips = [manager._main.tip]
    for number in range(3):
        manager.moving(number)
        tips.append(manager._main.tip)
        assert len(manager._tasks.objects) == decisions.EXPECTED["demands"]
    assert len(set(tips)) == 4
    manager.still(3)
    assert manager._main.tip == tips[-1]


@pytest.mark.parametrize("name", sorted(decisions.MODULES))
def test_every_name_lies_where_it_is_looked_for_first(name: str) -> None:
    assert hasattr(importlib.import_module(f"robotkube.{decisions.MODULES[name][0]}"), name)


def test_decisions_are_set_against_those_of_the_revision() -> None:
    quiet, busy = {"still": [2.0], "moving": [3.0]}, {"still": [9.0], "moving": [9.0]}
    compared = list(compare_revisions([busy, quiet], [{"still": [2.0], "moving": [2.0]}, busy], "abc"))
    assert [(one.name, one.passed) for one in compared] == [
        ("decision, p50", True),
        ("decision, p99", True),
        ("decision while main moves, p50", False),
        ("decision while main moves, p99", False),
    ]
    assert {one.baseline_is for one in compared} == {"the same at abc, each in its quietest of 2 rounds"}


def test_without_an_earlier_revision_nothing_is_compared() -> None:
    assert list(compare_revisions([{"still": [2.0], "moving": [3.0]}], [], "")) == []
    assert together([]) == {}
    document = decision_record(OURS, {}, "")
    assert (document["decision_before"], document["decision_before_moving_ms"]) == ("", None)


def test_a_revision_that_is_not_there_is_said() -> None:
    assert known("HEAD")
    assert not known("f" * 40)
    with pytest.raises(SetUpError, match="cannot be measured"), checkout("f" * 40):
        pass


def test_the_sources_of_a_revision_are_there_for_as_long_as_they_are_needed() -> None:
    with checkout("HEAD") as folder:
        assert (folder / "operator" / "src" / "robotkube" / "errors.py").is_file()
    assert not folder.exists()


def test_the_storm_is_a_module_of_the_tests() -> None:
    """It is started by its name, in a process of its own."""
    assert find_spec(application_manager.STORM) is not None
    assert (application_manager.TESTS / "tests" / "__init__.py").exists()
