"""One run of one suite: the chart is fetched by the digest that was asked for, and whatever happens becomes a result.

A suite that crashes, makes no checks or is of another version than the policy names is `unfinished`: never passed.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.charts.core.packing import IMAGES_FILE
from robotkube.registry.charts.ports import ChartProgram, PulledCharts
from robotkube.registry.evidence.core.statements import FINISHED, Artefact, Check, Outcome, SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites.core.requests import CHECKS_MAX, SuiteRequest, tidy
from robotkube.registry.suites.ports.suites import Subject, Suite, SuiteNamespace

NO_NAMESPACE = "suite"  # the namespace for which charts are rendered where there is no test namespace

log = logging.getLogger(__name__)


def unfinished(rule: SuiteRule, problem: str, seconds: float, fix: str = "") -> SuiteResult:
    """A run that came to no end."""
    fix = fix or "correct what is named here and submit again; if it is not the chart, see the log of suite-runner"
    check = Check(FINISHED, False, problem, fix)
    return SuiteResult(rule.name, rule.version, "unfinished", tidy([check]), round(max(seconds, 0.0), 1))


def run_suite(
    rule: SuiteRule,
    suite: Suite,
    subject: Callable[[], Subject],
    test_namespace: SuiteNamespace | None,
    clock: Callable[[], float],
) -> SuiteResult:
    """The result of a run; never raises for what the suite does."""
    started = clock()
    if suite.version != rule.version:
        words = f"the policy asks for suite {rule.name} version {rule.version}; this platform has {suite.version}"
        return unfinished(rule, words, 0.0, f"write version {suite.version!r} into the verification policy")
    try:
        checks = list(suite.run(subject(), test_namespace))
    except Exception as error:  # a suite's crash must not be ours, and is no pass
        log.info("suite crashed suite=%s error=%s reason=%s", rule.name, type(error).__name__, error)
        return unfinished(rule, _words(error), clock() - started)
    if not 0 < len(checks) <= CHECKS_MAX:
        words = f"the suite made {len(checks)} checks; it must make 1 to {CHECKS_MAX}"
        return unfinished(rule, words, clock() - started)
    outcome: Outcome = "passed" if all(check.passed for check in checks) else "failed"
    return SuiteResult(rule.name, rule.version, outcome, tidy(checks), round(clock() - started, 1))


def _words(error: Exception) -> str:
    known = isinstance(error, InputError) or getattr(error, "retriable", False)
    return str(error) if known and str(error) else f"{type(error).__name__}: {error}"


def read_subject(request: SuiteRequest, oci_registry: PulledCharts, program: ChartProgram, namespace: str) -> Subject:
    """The chart that the request names, and the one it replaces, from the OCI registry by digest. InputError when a
    chart is not what the request says."""
    replaced = None
    if request.replaced is not None:
        previous = request.replaced
        replaced = _subject(
            previous.artefact, previous.repository, previous.entry, None, oci_registry, program, namespace
        )
    return _subject(request.artefact, request.repository, request.entry, replaced, oci_registry, program, namespace)


def _subject(
    artefact: Artefact,
    repository: str,
    entry: Mapping[str, Any],
    replaced: Subject | None,
    oci_registry: PulledCharts,
    program: ChartProgram,
    namespace: str,
) -> Subject:
    chart = oci_registry.pull_chart(repository, artefact.digest)
    named = (str(chart.metadata.get("name")), str(chart.metadata.get("version")))
    if named != (artefact.chart, artefact.version):
        raise InputError(
            f"{repository}@{artefact.digest} is {' '.join(named)}, asked for was {artefact.chart} {artefact.version}"
        )

    def render(values: Mapping[str, Any], release: str) -> list[dict[str, Any]]:
        return program.render(chart.files, values, release, namespace)

    return Subject(artefact, entry, chart.files, chart.archive, _images(chart.files), render, replaced)


def _images(files: Mapping[str, bytes]) -> dict[str, str]:
    """Image name -> reference; empty without the file, which packing adds for charts that run images."""
    if IMAGES_FILE not in files:
        return {}
    try:
        text = files[IMAGES_FILE].decode()
    except UnicodeDecodeError as error:
        raise DocumentError(IMAGES_FILE, [f"not UTF-8: {error}"]) from error
    return {name: str(reference) for name, reference in read_mapping(text, IMAGES_FILE).items()}
