"""One run of one suite: what becomes of checks, crashes, versions; and the chart that was asked for."""

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.registry.charts.core.packing import PulledChart
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites.loops.run import read_subject, run_suite
from robotkube.registry.suites.ports.suites import Subject, SuiteNamespace
from robotkube.testing.suites import CHART, make_request, make_subject

RULE = SuiteRule("install", "1", 30)


class ScriptedSuite:
    """A suite that does what a test says."""

    name = "install"
    version = "1"
    needs_namespace = True

    def __init__(self, checks: Sequence[Check] = (), error: Exception | None = None) -> None:
        self._checks, self._error = checks, error

    def run(self, subject: Subject, test_namespace: SuiteNamespace | None) -> Sequence[Check]:
        if self._error:
            raise self._error
        return self._checks


@pytest.mark.parametrize(
    ("suite", "outcome", "words"),
    [
        (ScriptedSuite([Check("a", True)]), "passed", ""),
        (ScriptedSuite([Check("a", True), Check("b", False, "seen")]), "failed", "seen"),
        (ScriptedSuite([]), "unfinished", "0 checks"),
        (ScriptedSuite([Check(str(number), True) for number in range(201)]), "unfinished", "201 checks"),
        (ScriptedSuite(error=InputError("no broker")), "unfinished", "no broker"),
        (ScriptedSuite(error=UnavailableError("API server away")), "unfinished", "API server away"),
        (
            ScriptedSuite(error=ZeroDivisionError("division by zero")),
            "unfinished",
            "ZeroDivisionError: division by zero",
        ),
        (ScriptedSuite(error=MemoryError()), "unfinished", "MemoryError"),
    ],
)
def test_outcomes(suite: ScriptedSuite, outcome: str, words: str) -> None:
    result = run_suite(RULE, suite, make_subject, None, lambda: 1.0)
    assert (result.outcome, result.suite, result.version) == (outcome, "install", "1")
    assert words in " ".join(check.found for check in result.failed)


def test_another_version_than_the_policys_is_not_run() -> None:
    result = run_suite(
        SuiteRule("install", "2", 30), ScriptedSuite([Check("a", True)]), make_subject, None, lambda: 1.0
    )
    assert result.outcome == "unfinished"
    assert "asks for suite install version 2; this platform has 1" in result.checks[0].found


def test_a_chart_that_cannot_be_had_is_unfinished() -> None:
    def away() -> Subject:
        raise UnavailableError("registry away")

    assert run_suite(RULE, ScriptedSuite(), away, None, lambda: 1.0).outcome == "unfinished"


class Charts:
    """A registry with one chart, and the program that renders it."""

    def __init__(self, name: str = CHART, files: Mapping[str, bytes] | None = None) -> None:
        self.pulled: list[tuple[str, str]] = []
        self._chart = PulledChart({"name": name, "version": "0.2.0"}, files or {}, b"manifest", b"tgz")

    def pull_chart(self, repository: str, digest: str) -> PulledChart:
        self.pulled.append((repository, digest))
        return self._chart

    def render(self, files: Mapping[str, bytes], values: Any, release: str, namespace: str) -> list[dict[str, Any]]:
        return [{"values": values, "release": release, "namespace": namespace}]


def test_the_chart_is_fetched_by_the_digest_that_was_asked_for() -> None:
    charts = Charts(files={"images.yaml": b"ros: r@sha256:0\n"})
    request = make_request()
    subject = read_subject(request, charts, charts, "suite")  # type: ignore[arg-type]  # one of its methods is needed
    assert charts.pulled == [(request.repository, request.artefact.digest)]
    assert (subject.images, subject.archive) == ({"ros": "r@sha256:0"}, b"tgz")
    assert subject.render({"a": 1}, "name") == [{"values": {"a": 1}, "release": "name", "namespace": "suite"}]


@pytest.mark.parametrize(
    ("charts", "words"),
    [
        (Charts("other"), "asked for was greeter 0.2.0"),
        (Charts(files={"images.yaml": b"\xff"}), r"images\.yaml: not UTF-8"),
        (Charts(files={"images.yaml": b"- a"}), r"images\.yaml: must hold exactly one"),
    ],
)
def test_a_chart_that_is_not_what_was_asked_for(charts: Charts, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_subject(make_request(), charts, charts, "suite")  # type: ignore[arg-type]
