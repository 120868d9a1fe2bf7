"""Suites of a user's own: a container image that checks one chart and prints its checks.

/suite/request.json   chart, version, digest, platform, sets, test_namespace, ...: docs/how-to/write-a-suite.md
/suite/chart.tgz      the chart, as it is in the registry
last line of stdout   {"checks": [{"name", "passed", "found", "fix"}]}
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites.core.requests import TestSet, read_checks
from robotkube.registry.suites.loops.installation import filled_sets, install
from robotkube.registry.suites.ports.suites import PodRun, Subject, SuiteNamespace

INSTALLED = "installed-for-the-suite"
MARGIN_SECONDS = 5.0  # kept for reporting what happened
LAST_LINES_MAX = 12
STDERR_LINES_MAX = 50


class CustomSuite:
    """The port Suite for a rule that names an image."""

    needs_namespace = True

    def __init__(self, rule: SuiteRule, render: Render, now_ns: Callable[[], int]) -> None:
        self._rule = rule
        self._render = render
        self._now_ns = now_ns

    @property
    def name(self) -> str:
        """The suite as the policy names it."""
        return self._rule.name

    @property
    def version(self) -> str:
        """The version that the policy says: the image is a part of the policy, and by that of its digest."""
        return self._rule.version

    def run(self, subject: Subject, test_namespace: SuiteNamespace | None) -> Sequence[Check]:
        """The image's checks. InputError, which makes the run unfinished, when it gives no proper result."""
        if test_namespace is None:
            raise InputError("a suite of one's own needs a test namespace")
        sets = filled_sets(subject.entry, test_namespace.agent, self._now_ns(), self._render)
        if self._rule.installs:
            problem = self._install(subject, test_namespace, sets[0])
            if problem:
                fix = "let the chart get ready with the first set of spec.suites.sets; see the suite install"
                return [Check(INSTALLED, False, problem, fix)]
        files = {
            "request.json": canonical_json(self._request(subject, test_namespace, sets)),
            "chart.tgz": subject.archive,
        }
        seconds = max(test_namespace.seconds_left - MARGIN_SECONDS, 1.0)
        return read_result(
            test_namespace.run_pod(self._rule.name, self._rule.image, self._rule.command, files, seconds, accounts=True)
        )

    def _install(self, subject: Subject, test_namespace: SuiteNamespace, test_set: TestSet) -> str:
        try:
            return install(subject, test_namespace, test_set).problem
        except InputError as error:
            return str(error)

    def _request(self, subject: Subject, test_namespace: SuiteNamespace, sets: Sequence[TestSet]) -> Mapping[str, Any]:
        artefact = subject.artefact
        place = {
            "namespace": test_namespace.namespace,
            "agent": test_namespace.agent,
            "domain_id": test_namespace.domain_id,
        }
        return {
            "chart": artefact.chart,
            "version": artefact.version,
            "digest": artefact.digest,
            "platform": artefact.platform,
            "sets": [{"name": test_set.name, "values": test_set.values} for test_set in sets],
            "test_namespace": place,
            "room": place,  # the former name, for images that were published when it was this one
            "namespace": test_namespace.namespace,
            "release": artefact.chart if self._rule.installs else "",
        }


def _last_line(log: str, tail: str) -> Mapping[str, Any]:
    """The last JSON object; a pod's log has stderr in it as well, so a few lines may follow."""
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    for line in reversed(lines[-STDERR_LINES_MAX:]):
        try:
            document = read_json(line)
        except ValueError:
            continue
        if isinstance(document, dict):
            return document
    raise InputError(f"the suite's last line of stdout is no JSON object with `checks`:\n{tail}")


def read_result(run: PodRun) -> tuple[Check, ...]:
    """The checks in the last line of a pod's stdout; InputError when there are none or the pod failed."""
    tail = "\n".join(run.log.splitlines()[-LAST_LINES_MAX:])
    if run.exit_code != 0:
        ended = run.problem if run.exit_code is None else f"it ended with {run.exit_code}"
        raise InputError(f"the suite's pod did not end with 0: {ended}\nlast lines of its log:\n{tail}")
    reader = Reader("result of the suite")
    root = reader.mapping(_last_line(run.log, tail), "", ["checks"])
    checks = read_checks(reader, root.get("checks"), "checks")
    reader.finish()
    if not checks:
        raise DocumentError("result of the suite", ["checks: empty; say at least one"])
    return checks
