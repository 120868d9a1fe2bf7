"""What came of the checks of one proposal: each by its name in words, with its problems and the time that it took.

A check that is made of several files counts as one. What was not tried, since something before it did not hold, is not
among the results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

ONE_COMMIT = "it is one commit on main's tip"
AUTHOR = "its author is the process that leads"
FILES = "it touches only files that it may"
REPAIR_ONLY = "it does nothing but bring main back"
TOGETHER = "releases and sources fit together"
NAMESPACES = "its namespaces are its author's own"
USED = "every source is used"
ORIGIN = "charts come from where verified ones are"
CHART = "charts are in the catalogue, and their evidence holds"
VALUES = "values fit the charts' schemas"
TOPICS = "topics of other scopes are heard with their consent"
PARAMETERS = "parameters fit the applications"
IMAGES = "images are those that the evidence covers"
MESSAGE = "its message names what it changes"
POLICIES = "policies can be read"
READABLE = "it can be read"

MOVED = "main has moved since it was made"


@dataclass(frozen=True)
class CheckResult:
    """One check: what it is, its problems, none when it passed, and how long it took."""

    name: str
    problems: tuple[str, ...]
    seconds: float


def no_clock() -> float:
    """Stand still: nobody asks how long checks take."""
    return 0.0


class CheckLog:
    """The checks of one proposal as they are made. `clock` counts seconds."""

    def __init__(self, clock: Callable[[], float] = no_clock) -> None:
        self._clock = clock
        self._results: dict[str, CheckResult] = {}

    def run(self, name: str, problems: Iterable[str]) -> Sequence[str]:
        """Make a check, which is to go through its `problems`, and return them."""
        began = self._clock()
        found = tuple(problems)
        seconds = self._clock() - began
        before = self._results.get(name, CheckResult(name, (), 0.0))
        self._results[name] = CheckResult(name, before.problems + found, before.seconds + seconds)
        return found

    @property
    def results(self) -> tuple[CheckResult, ...]:
        """The checks that were made, in their order."""
        return tuple(self._results.values())
