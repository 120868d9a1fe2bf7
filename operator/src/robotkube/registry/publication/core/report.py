"""The gate's report in the pull request of a submission, as Markdown: the verdict first, then what every suite
found and how to fix it, then digests and addresses.

What suites found comes out of other people's charts: it is shown as quoted text only, bounded, never as markup.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from robotkube.foundation.documents.core.shortening import shortened
from robotkube.registry.evidence.core.statements import Artefact, Check

MARKER = "<!-- robotkube: publication -->"
PROBLEMS_SHOWN_MAX = 50
CHECKS_SHOWN_MAX = 20  # failed ones of a suite
TEXT_CHARACTERS_MAX = 600  # of what suites quote
SENTENCE_CHARACTERS_MAX = 1_000  # of problems, which name images with their digests in their midst
REPORT_CHARACTERS_MAX = 60_000  # of 65,535 that forges take

CHECKING, WAITING, VERIFIED, REFUSED, UNCHANGED = "checking", "waiting", "verified", "refused", "unchanged"
NOT_ENDED = ("waiting", "queued")  # of a suite that never begins when the submission is refused
ENDED = "ended"  # before a result's time
UNDECIDED = "Nothing is decided yet, the gate goes on by itself."
HEADLINES: Mapping[str, str] = {
    CHECKING: "Checking",
    WAITING: "Waiting",
    VERIFIED: "Verified",
    REFUSED: "Refused",
    UNCHANGED: "Already published",
}


@dataclass(frozen=True)
class SuiteReport:
    """How a suite of a chart stands: `state` is waiting, queued, running, passed, failed or unfinished; `ended` when
    its result came, as RFC 3339."""

    name: str
    version: str
    state: str
    seconds: float | None = None
    note: str = ""
    failed: tuple[Check, ...] = ()
    reserved: tuple[Check, ...] = ()
    ended: str = ""


@dataclass(frozen=True)
class ChartReport:
    """A chart of the submission; `evidence` is the summary's digest once there is one."""

    artefact: Artefact
    suites: tuple[SuiteReport, ...]
    evidence: str = ""


@dataclass(frozen=True)
class Report:
    """The content of the comment. `names` is what the submission is about, `commit` its head; `charts_url` where
    verified charts are (`oci://host/organisation`)."""

    verdict: str
    names: str
    commit: str
    charts_url: str = ""
    policy: str = ""
    charts: tuple[ChartReport, ...] = ()
    problems: tuple[str, ...] = ()
    waiting_for: str = ""
    applications: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())


def report_text(report: Report) -> str:
    """The comment."""
    lines = [MARKER, f"## {HEADLINES[report.verdict]}: {plain(report.names)}", "", _verdict(report), ""]
    if report.problems:
        lines += [*_problem_lines(report.problems), ""]
    for chart in report.charts:
        lines += _chart_lines(chart, report)
    if report.applications:
        lines += [f"Applications: {', '.join(map(quoted, report.applications))}", ""]
    lines += [f"- {plain(note)}" for note in report.notes]
    lines += ["", _footer(report)]
    text = "\n".join(lines).replace("\n\n\n", "\n\n").rstrip() + "\n"
    return text if len(text) <= REPORT_CHARACTERS_MAX else text[:REPORT_CHARACTERS_MAX] + "\n\n(cut off)\n"


def _verdict(report: Report) -> str:
    if report.verdict == REFUSED:
        failed = [f"{s.name} of {c.artefact.chart} {_word(s)}" for c in report.charts for s in c.suites if _is_bad(s)]
        what = f"{', '.join(failed)}. " if failed else ""
        return f"Nothing was published. {what}Change what is named below and submit again."
    if report.verdict == WAITING:
        return f"{UNDECIDED} It waits: {plain(report.waiting_for)}"
    if report.verdict == VERIFIED:
        return "All that the policy asks for is met. It is published the moment this pull request shows as merged."
    if report.verdict == UNCHANGED:
        return "The catalogue has exactly this already; there is nothing to do."
    done = sum(suite.state == "passed" for chart in report.charts for suite in chart.suites)
    total = sum(len(chart.suites) for chart in report.charts)
    return f"{done} of {total} suites passed so far."


def _is_bad(suite: SuiteReport) -> bool:
    return suite.state in ("failed", "unfinished")


def _word(suite: SuiteReport) -> str:
    return "did not finish" if suite.state == "unfinished" else suite.state


def _problem_lines(problems: Sequence[str]) -> Iterable[str]:
    yield from (f"- {plain(problem)}" for problem in problems[:PROBLEMS_SHOWN_MAX])
    if len(problems) > PROBLEMS_SHOWN_MAX:
        yield f"- and {len(problems) - PROBLEMS_SHOWN_MAX} more"


def _chart_lines(chart: ChartReport, report: Report) -> list[str]:
    artefact = chart.artefact
    lines = [f"### {plain(f'{artefact.chart} {artefact.version}')}", ""]
    lines += ["| suite | result | time | |", "| --- | --- | --- | --- |"]
    lines += [_row(suite, report.verdict == REFUSED) for suite in chart.suites]
    lines.append("")
    for suite in chart.suites:
        if _is_bad(suite):
            lines += _failure_lines(suite)
    lines += [
        f"- {plain(suite.name)}, {plain(check.name)}: {quoted(check.found)}"
        for suite in chart.suites
        for check in suite.reserved
    ]
    lines += [f"- chart: {quoted(f'{artefact.chart}@{artefact.digest}')} ({plain(artefact.platform)})"]
    if chart.evidence:
        lines += [
            f"- evidence: {quoted(chart.evidence)}, in this repository below {quoted(artefact.folder + '/')}",
            f"- published as {quoted(f'{report.charts_url}/{artefact.chart}@{artefact.digest}')}",
        ]
    return [*lines, ""]


def _row(suite: SuiteReport, ended: bool) -> str:
    seconds = "" if suite.seconds is None else f"{suite.seconds:.1f} s"
    words = f"**{_word(suite)}**" if _is_bad(suite) else suite.state
    state = "not run" if ended and suite.state in NOT_ENDED else words
    note = ", ".join(filter(None, (suite.note, f"{ENDED} {suite.ended}" if suite.ended else "")))
    return f"| {plain(suite.name)} {plain(suite.version)} | {state} | {seconds} | {plain(note)} |"


def _failure_lines(suite: SuiteReport) -> list[str]:
    lines = [f"**{plain(suite.name)} {_word(suite)}:**", ""]
    for check in suite.failed[:CHECKS_SHOWN_MAX]:
        lines.append(f"- {plain(check.name)}")
        if check.found:
            lines.append(f"  - found: {quoted(check.found)}")
        if check.fix:
            lines.append(f"  - do: {plain(check.fix)}")
    if len(suite.failed) > CHECKS_SHOWN_MAX:
        lines.append(f"- and {len(suite.failed) - CHECKS_SHOWN_MAX} more checks")
    if not suite.failed:
        lines.append("- it ended without a result; submit again, or ask who runs the platform")
    return [*lines, ""]


def _footer(report: Report) -> str:
    policy = f", policy {quoted(report.policy)}" if report.policy else ""
    return f"Commit {quoted(report.commit[:12])}{policy}."


def quoted(text: str) -> str:
    """`text` as one line of code: no markup in it counts."""
    line = " ".join(text.split()).replace("`", "'")
    return f"`{shortened(line, TEXT_CHARACTERS_MAX)}`" if line else "(nothing)"


def plain(text: str) -> str:
    """`text` as one line in which nothing is a link, a mention or HTML."""
    line = shortened(" ".join(text.split()), SENTENCE_CHARACTERS_MAX)
    for character in "\\`*_[]<>|":
        line = line.replace(character, f"\\{character}" if character != "<" else "&lt;")
    return line.replace("@", "&#64;")


def readable_text(comment: str) -> str:
    """A report as a terminal shows it: without marker and escapes."""
    lines = [line for line in comment.splitlines() if line != MARKER]
    text = "\n".join(lines).replace("&lt;", "<").replace("&#64;", "@")
    for character in "`*_[]>|\\":
        text = text.replace(f"\\{character}", character)
    return text.strip() + "\n"
