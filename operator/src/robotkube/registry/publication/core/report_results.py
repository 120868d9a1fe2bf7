"""Results of suites, read out of the gate's report in a pull request."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from robotkube.registry.publication.core.report import ENDED, readable_text

RESULTS = {"passed": "passed", "failed": "failed", "did not finish": "unfinished"}
ROW = re.compile(r"\| (\S+ \S+) \| ([^|]+) \| (?:([0-9.]+) s)? ?\| (.*)\|")
FAILURES = re.compile(r"\*\*(\S+) (?:failed|did not finish):\*\*")
ENDED_AT = re.compile(rf"{ENDED} (\S+)")


@dataclass(frozen=True)
class ReportedResult:
    """How a suite ended: `chart` and `suite` with their versions, `result` passed, failed or unfinished, `ended` as RFC
    3339 (empty: it ran for an earlier submission), `checks` the names of the failed ones."""

    chart: str
    suite: str
    result: str
    seconds: float | None = None
    ended: str = ""
    checks: tuple[str, ...] = ()


def reported_results(report: str) -> list[ReportedResult]:
    """The results in a report's text, in its order."""
    text = readable_text(report)
    sections = re.split(r"^### ", text, flags=re.MULTILINE)[1:]
    return [result for section in sections for result in _results(*section.partition("\n")[::2])]


def _results(chart: str, section: str) -> Iterator[ReportedResult]:
    lines = section.splitlines()
    checks = _failed_checks(lines)
    for match in filter(None, map(ROW.fullmatch, lines)):
        suite, state, seconds, note = match.groups()
        result = RESULTS.get(state.strip("* "))
        if result:
            ended = ENDED_AT.search(note)
            yield ReportedResult(
                chart.strip(),
                suite,
                result,
                float(seconds) if seconds else None,
                ended[1] if ended else "",
                checks.get(suite.partition(" ")[0], ()),
            )


def _failed_checks(lines: list[str]) -> dict[str, tuple[str, ...]]:
    """Suite -> names of failed checks."""
    checks: dict[str, tuple[str, ...]] = {}
    suite = ""
    for line in lines:
        if match := FAILURES.fullmatch(line):
            suite = match[1]
        elif line.startswith("- chart: "):
            break
        elif suite and line.startswith("- "):
            checks[suite] = (*checks.get(suite, ()), line.removeprefix("- "))
    return checks
