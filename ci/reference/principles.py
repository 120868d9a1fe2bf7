"""docs/reference/design-principles.md: the rows of the paper's Table I, the story of each, and what became of it.

Stories are the docstrings of operator/tests/platform/table_one/test_p01.py to test_p10.py. Runs of them leave their
results in build/reports/table-one.json and change no file of the repository; `make reference` brings them into the
page, which keeps what it says of a story that has not run since.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ci.docs import markdown
from ci.folders import PROJECT

RESULTS = PROJECT / "build" / "reports" / "table-one.json"
PAGE = PROJECT / "docs" / "reference" / "design-principles.md"
TESTS = PROJECT / "operator" / "tests" / "platform" / "table_one"
NAMES = tuple(f"p{number:02}" for number in range(1, 11))
WORDS = {"passed": "holds", "failed": "does not hold", "skipped": "not tried"}
UNKNOWN = "not tried"
MARKS = ("Example: ", "Story: ", "Asserted: ")
ROW = re.compile(r"^\| \[(p\d\d)\].*\| ([a-z ]+) \|$", re.MULTILINE)
HEAD = """# Design principles

The ten rows of the paper's Table I, each with the paper's example told as a story on a real cluster, and what is
asserted: on Git and on the cluster (pods, nodes, messages, conditions of tasks). Where a story needs a sensor, its
messages are published on the sensor's agent, as a driver would; what crosses from one agent to another and what an
operator decides on goes the way it always goes. Written by `make reference` from the tests and from the results of
their last run on the shared test cluster (`ci/python -m ci.test --only platform`).
"""


@dataclass(frozen=True)
class Principle:
    """One row: name of the test, the principle, the paper's example, the story, and what is asserted."""

    name: str
    principle: str
    example: str
    story: str
    asserted: str


def read_principles(tests: Path = TESTS) -> tuple[Principle, ...]:
    """The rows, in the order of the table. ValueError names a file that is missing, too many, or without its four
    paragraphs."""
    stories = {path.stem.removeprefix("test_"): path for path in sorted(tests.glob("test_*.py"))}
    if tuple(stories) != NAMES:
        raise ValueError(f"{tests}: must hold exactly {', '.join(NAMES)}; it holds {', '.join(stories) or 'none'}")
    return tuple(_principle(name, path) for name, path in stories.items())


def _principle(name: str, path: Path) -> Principle:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    parts = [" ".join(part.split()) for part in text.split("\n\n")]
    if len(parts) != 1 + len(MARKS) or not all(map(str.startswith, parts[1:], MARKS)):
        raise ValueError(f"{path}: its docstring must be the principle and paragraphs with {', '.join(MARKS)}")
    return Principle(name, parts[0], *map(str.removeprefix, parts[1:], MARKS))


def read_results(path: Path = RESULTS) -> dict[str, str]:
    """Name -> passed, failed or skipped of the last run; empty when there was none."""
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def page(principles: Sequence[Principle], results: Mapping[str, str]) -> str:
    """The whole page."""
    lines = [HEAD, "| | principle | last run |", "| --- | --- | --- |"]
    lines += [
        f"| [{principle.name}](#{principle.name}) | {principle.principle} "
        f"| {WORDS.get(results.get(principle.name, ''), UNKNOWN)} |"
        for principle in principles
    ]
    text = "\n".join([*lines, "", *(line for principle in principles for line in _chapter(principle))]).rstrip() + "\n"
    return markdown.wrapped(text)


def results_of(text: str) -> dict[str, str]:
    """Name -> passed or failed, as a page states it."""
    results = {word: result for result, word in WORDS.items() if word != UNKNOWN}
    return {name: results[word] for name, word in ROW.findall(text) if word in results}


def known(results: Mapping[str, str]) -> dict[str, str]:
    """Those of `results` that are passed or failed."""
    return {name: result for name, result in results.items() if WORDS.get(result, UNKNOWN) != UNKNOWN}


def differences() -> str:
    """Results of the last run that are not those of the page, in words; empty when they agree."""
    before = results_of(PAGE.read_text(encoding="utf-8"))
    changed = {name: result for name, result in known(read_results()).items() if before.get(name) != result}
    return ", ".join(f"{name} {WORDS[result]}" for name, result in sorted(changed.items()))


def _chapter(one: Principle) -> Iterator[str]:
    test = f"../../operator/tests/platform/table_one/test_{one.name}.py"
    yield from (f"## {one.name}", "", one.principle, "")
    yield from (f"*The paper's example.* {one.example}", "")
    yield from (f"*The story* ([test]({test})). {one.story}", "")
    yield from (f"*What is asserted*: {one.asserted}", "")


def write() -> Path:
    """Write the page; returns its path."""
    results = results_of(PAGE.read_text(encoding="utf-8")) | known(read_results())
    PAGE.write_text(page(read_principles(), results), encoding="utf-8")
    return PAGE


if __name__ == "__main__":
    print(write().relative_to(PROJECT))
