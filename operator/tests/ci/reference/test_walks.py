"""The three walks of architecture.md: they are what the code does, and none is longer than its bound."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pytest

from ci.reference import architecture
from ci.reference.walks import __main__ as command
from ci.reference.walks import page, pose, submission
from ci.reference.walks.page import WALKS, Count, count, counted
from ci.reference.walks.recording import SOURCE, Route, WalkRecorder
from robotkube.registry.publication.loops.verification import ChartVerification
from robotkube.robots.detector.loops.dispatching import Dispatcher

POSE, TASK, SUBMISSION = WALKS
FORWARDING = "def forwarding(function):\n    return lambda *values: function(*values)\n"


@pytest.fixture(scope="module")
def counts() -> Sequence[Count]:
    return counted()


def injected(file: str, source: str, name: str) -> Any:
    """A function of a module that stands in the platform's folder for this test alone."""
    names: dict[str, Any] = {}
    exec(compile(source, str(SOURCE / file), "exec"), names)  # noqa: S102 - the test's own text
    return names[name]


def files(counted_walk: Count) -> list[str]:
    return [page.module_of(station.path) for station in counted_walk.stations]


def test_no_walk_is_longer_than_its_bound(counts: Sequence[Count]) -> None:
    assert [problem for one in counts for problem in one.problems] == []
    assert [one.walk.files_max for one in counts] == [8, 15, 15]


def test_the_page_is_current(counts: Sequence[Count]) -> None:
    text = architecture.PAGE.read_text(encoding="utf-8")
    assert text == page.rewritten(text, counts), "run: make reference"


def test_a_walk_is_the_same_each_time(counts: Sequence[Count]) -> None:
    assert [files(count(one.walk)) for one in counts] == [files(one) for one in counts]


@pytest.mark.parametrize(
    ("walk", "owner", "function"),
    [(POSE, Dispatcher, Dispatcher.react), (SUBMISSION, ChartVerification, ChartVerification.publish)],
)
def test_a_module_that_only_passes_on_makes_a_walk_too_long(
    walk: page.Walk,
    owner: type,
    function: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    forwarding = injected("robots/detector/loops/forwarding.py", FORWARDING, "forwarding")
    monkeypatch.setattr(owner, function.__name__, functools.wraps(function)(forwarding(function)))
    grown = count(walk)
    assert len(grown.stations) == walk.files_max + 1
    assert "robots/detector/loops/forwarding.py" in files(grown)
    words = f"{walk.title}: {walk.files_max + 1} files, at most {walk.files_max}; look for what only passes on"
    assert grown.problems == [words]
    monkeypatch.setattr(command, "counted", lambda: [grown])
    assert command.main() == 1
    assert words in capsys.readouterr().err


def test_a_value_that_does_not_come_to_its_end_is_a_problem() -> None:
    stopped = count(replace(POSE, run=lambda recorder: None))
    assert "A pose to an event: the value did not pass EventRecord" in stopped.problems
    lost = count(replace(POSE, route=lambda: replace(pose.route(), forms=(*pose.route().forms, Count))))
    assert lost.problems == ["A pose to an event: the value did not pass Count"]


def test_a_port_whose_adapter_nobody_names_is_a_problem() -> None:
    nameless = count(replace(SUBMISSION, route=lambda: replace(submission.route(), adapters={})))
    assert any(
        "MemoryCatalogueForge.pull_requests gives the value; say which adapter that is" in p for p in nameless.problems
    )


# -- the definition, on modules of its own -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Given:
    """The first form."""

    name: str


@dataclass(frozen=True)
class Made:
    """The second one."""

    name: str


ENTERED = """
def turn(given, make, check):
    assert check(given)
    return make(given)
"""
CHECKING = "def check(given):\n    return bool(given.name)\n"
MAKING = "def make(made, given):\n    return made(given.name)\n"
COPYING = "def make(made, given):\n    return type(given)(given.name)\n"


def walked(making: str, end: type) -> list[str]:
    recorder = WalkRecorder(Route((Given, Made), end))
    turn = injected("entered.py", ENTERED, "turn")
    check = injected("checking.py", CHECKING, "check")
    make = functools.partial(injected("making.py", making, "make"), Made)
    with recorder.recording():
        turn(Given("one"), make, check)
    return [path.name for path in recorder.stations]


def test_what_makes_the_next_form_is_walked_through_and_what_only_answers_is_looked_up() -> None:
    assert walked(MAKING, Made) == ["entered.py", "making.py"]


def test_the_same_value_again_is_no_next_form() -> None:
    assert walked(COPYING, Made) == ["entered.py"]
