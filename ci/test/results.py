"""A pytest plugin that writes each result as it comes, so that the counts of a run that dies are still known.

One JSON line per fact in the file named by ROBOTKUBE_TEST_RESULTS: {"test": <node id>, "outcome": "started" | "passed"
| "failed" | "skipped", "why": <what a failure said>}. A test's outcome is the worst of its lines; one that only started
died with its run, of whose end a line {"ended": <why>} tells if pytest itself could still say it. The last line of a
run that ends by itself is {"seconds": {<file>: <of its tests together>}}.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

VARIABLE = "ROBOTKUBE_TEST_RESULTS"
WORST_LAST = ("started", "passed", "skipped", "failed")
WHY_CHARACTERS_MAX = 400


@dataclass(frozen=True)
class Counts:
    """Numbers of tests by how they ended; `died` are those that started and never ended (they count as failed).
    `failures` says of each failed one, in one line, why; `seconds` what those of each file took, of a run that ended by
    itself."""

    passed: int
    failed: int
    skipped: int
    died: tuple[str, ...] = ()
    failures: Mapping[str, str] = field(default_factory=dict, compare=False)
    seconds: Mapping[str, float] = field(default_factory=dict, compare=False)


def read(path: Path, code: int = 0) -> Counts:
    """Counts of a results file; all zero when the run did not even begin. `code` is what pytest ended with."""
    outcomes: dict[str, str] = {}
    failures: dict[str, str] = {}
    said: list[str] = []
    seconds: dict[str, float] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        fact = json.loads(line)
        if "ended" in fact:
            said.append(fact["ended"])
            continue
        if "seconds" in fact:
            seconds = fact["seconds"]
            continue
        known = outcomes.get(fact["test"], "started")
        outcomes[fact["test"]] = max(known, fact["outcome"], key=WORST_LAST.index)
        if fact["outcome"] == "failed":
            failures.setdefault(fact["test"], fact["why"])
    ends = list(outcomes.values())
    died = tuple(test for test, outcome in outcomes.items() if outcome == "started")
    code_says = f"pytest ended by {signal.Signals(-code).name}" if code < 0 else f"pytest ended with {code}"
    end = next(iter(said), code_says)  # what comes after the first follows from it
    failures |= dict.fromkeys(died, f"the run ended in the middle of it: {end}")
    failed = ends.count("failed") + len(died)
    return Counts(ends.count("passed"), failed, ends.count("skipped"), died, failures, seconds)


def why(report: pytest.TestReport | pytest.CollectReport) -> str:
    """What a failure says, in one line: its exception where pytest knows one, or the end of the report."""
    crash = getattr(report.longrepr, "reprcrash", None)
    text = " ".join((crash.message if crash else report.longreprtext).split())
    return text[:WHY_CHARACTERS_MAX] if crash else text[-WHY_CHARACTERS_MAX:]


def pytest_configure(config: pytest.Config) -> None:
    """Take the file's name now: a test may run another pytest with a file of its own.

    Where several processes run the tests, the one that started them notes: it hears of each result, and of each
    process that died in a test.
    """
    if hasattr(config, "workerinput"):
        signal.signal(signal.SIGINT, _interrupted)
        return
    config.pluginmanager.register(Recorder(Path(os.environ[VARIABLE])))
    # Started in the background, a shell has interrupts ignored: then fixtures could not be taken down by one.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _interrupted(*_: object) -> None:
    """Count the first interrupt alone: terminal, recorder and pytest-xdist each send one, and one is enough to have
    the fixtures taken down."""
    signal.signal(signal.SIGINT, lambda *_: None)
    raise KeyboardInterrupt


@dataclass(frozen=True)
class Recorder:
    """Pytest's hooks; each appends a line at once. `processes` are those that run tests for this one."""

    path: Path
    processes: list[int] = field(default_factory=list, compare=False)
    seconds: dict[str, float] = field(default_factory=dict, compare=False)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodeready(self, node: Any) -> None:
        """A process is ready to run tests."""
        self.processes.append(node.gateway._rinfo().pid)

    def pytest_keyboard_interrupt(self) -> None:
        """Interrupt the others now: pytest-xdist does it after five seconds, of the ten until it kills them."""
        self.append({"ended": "pytest was interrupted"})
        for process in self.processes:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGINT)

    def pytest_internalerror(self, excrepr: object) -> None:
        """What pytest, or a plugin of it, did not expect; also in a process that runs tests for this one."""
        self.append({"ended": f"internal error: {' '.join(str(excrepr).split())[-WHY_CHARACTERS_MAX:]}"})

    def note(self, test: str, outcome: str, why: str = "") -> None:
        """Add a test's line."""
        self.append({"test": test, "outcome": outcome, "why": why})

    def append(self, fact: Mapping[str, object]) -> None:
        """One line."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(fact) + "\n")

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.note(nodeid, "started")

    def pytest_sessionfinish(self) -> None:
        self.append({"seconds": self.seconds})

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        file = report.nodeid.partition("::")[0]
        self.seconds[file] = self.seconds.get(file, 0.0) + report.duration
        if report.when == "call" or report.outcome != "passed":
            self.note(report.nodeid, report.outcome, why(report) if report.failed else "")

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A file that cannot be imported is a failure of its own."""
        if report.outcome == "failed":
            self.note(report.nodeid, "failed", why(report))
