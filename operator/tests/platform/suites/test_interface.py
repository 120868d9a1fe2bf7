"""The interface suite on the cluster: charts with a mistake are installed in test namespaces, seen from beside, and
refused in words. The same mistakes on processes: registry/suites/test_interface_processes.py. What is right about the
platform's own charts is proved by their publication."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from robotkube.registry.evidence.core.statements import SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from tests.stages.platform import suite_namespaces
from tests.stages.platform.running_platform import Platform
from tests.stages.registry.wrong_interfaces import MISTAKES, wrong_chart

pytestmark = pytest.mark.thorough

NAMES = ("undeclared-topic", "wrong-type", "unused-input")
SECONDS = 240
VERDICT_SECONDS_MAX = 2 * SECONDS + 60.0
RULE = SuiteRule("interface", "2", SECONDS)


@pytest.fixture(scope="module")
def results(platform: Platform, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, SuiteResult]:
    """What the suite-runner says of each chart; all are asked for at once and run in the namespaces of the pool."""
    asked = {
        name: suite_namespaces.request(platform, *wrong_chart(name, tmp_path_factory.mktemp(name)), RULE)
        for name in NAMES
    }
    return suite_namespaces.results(platform, asked, VERDICT_SECONDS_MAX)


@pytest.mark.parametrize("name", NAMES)
def test_a_wrong_chart_is_refused_with_words_that_say_it(results: Mapping[str, SuiteResult], name: str) -> None:
    result, mistake = results[name], MISTAKES[name]
    said = suite_namespaces.said(result)
    assert result.outcome == "failed", said
    failed = {check.name: check for check in result.failed}
    assert f"set first: {mistake.check}" in failed, said
    check = failed[f"set first: {mistake.check}"]
    assert mistake.found in check.found
    assert mistake.fix in check.fix
    assert all(check.name.startswith(("set first: ", "set second: ")) for check in result.failed), said
    assert "set second: runs" in {check.name for check in result.checks if check.passed}


def test_the_test_namespaces_are_empty_afterwards(platform: Platform, results: Mapping[str, SuiteResult]) -> None:
    assert results
    suite_namespaces.await_empty(platform)
