"""Suites of a user's own: what their image gets, what its last line may say, and what makes a run unfinished."""

import json
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites.loops.custom import CustomSuite, read_result
from robotkube.registry.suites.ports.suites import PodRun
from robotkube.testing.suites import DIGEST, MemoryTestNamespace, make_subject

IMAGE = "forge.example/team/suite@sha256:" + "0" * 64


def run(test_namespace: MemoryTestNamespace, **more: Any) -> list[Check]:
    rule = SuiteRule("politeness", "3", 60, image=IMAGE, command=("look",), **more)
    suite = CustomSuite(rule, Jinja2Templates().render, lambda: 7)
    assert (suite.name, suite.version, suite.needs_namespace) == ("politeness", "3", True)
    return list(suite.run(make_subject(), test_namespace))


def said(*checks: dict[str, Any]) -> PodRun:
    return PodRun(f"looking\n{json.dumps({'checks': checks})}\n\n", 0)


def test_the_image_gets_request_and_chart_and_its_last_line_counts() -> None:
    test_namespace = MemoryTestNamespace(
        runs=[said({"name": "greets", "passed": True}, {"name": "thanks", "passed": False, "found": "f"})]
    )
    assert run(test_namespace) == [Check("greets", True), Check("thanks", False, "f")]
    [(kind, pod)] = test_namespace.calls
    assert (kind, pod["name"], pod["image"], pod["command"]) == ("run_pod", "politeness", IMAGE, ("look",))
    assert pod["files"]["chart.tgz"] == b"tgz"
    request = json.loads(pod["files"]["request.json"])
    assert (request["chart"], request["version"], request["digest"]) == ("greeter", "0.2.0", DIGEST)
    assert request["sets"][0] == {"name": "one", "values": {"placement": {"agent": "cloud-0"}, "word": "hello"}}
    place = {"namespace": "robotkube-suite-0", "agent": "cloud-0", "domain_id": 90}
    assert request["test_namespace"] == place
    assert request["room"] == place, "the former name, which published images read"
    assert request["release"] == ""


def test_the_chart_is_installed_before_when_the_rule_says_so() -> None:
    test_namespace = MemoryTestNamespace(runs=[said({"name": "greets", "passed": True})])
    assert run(test_namespace, installs=True) == [Check("greets", True)]
    assert [name for name, _ in test_namespace.calls] == ["apply", "run_pod"]
    assert json.loads(test_namespace.calls[1][1]["files"]["request.json"])["release"] == "greeter"


def test_a_chart_that_does_not_get_ready_fails_before_the_image_runs() -> None:
    test_namespace = MemoryTestNamespace(readiness=["no pod"])
    [check] = run(test_namespace, installs=True)
    assert (check.passed, check.found) == (False, "no pod")
    assert [name for name, _ in test_namespace.calls] == ["apply"]


def test_lines_of_stderr_may_follow() -> None:
    run = PodRun('{"checks": [{"name": "a", "passed": true}]}\nwarning: slow clock\n', 0)
    assert read_result(run) == (Check("a", True),)


@pytest.mark.parametrize(
    ("pod", "words"),
    [
        (PodRun("Traceback\nboom", 1), "ended with 1\nlast lines of its log:\nTraceback\nboom"),
        (PodRun("working", None, "it did not end in its time"), "it did not end in its time"),
        (PodRun("", 0), "last line of stdout is no JSON object"),
        (PodRun("done", 0), "last line of stdout is no JSON object with `checks`:\ndone"),
        (PodRun("[1]", 0), "is no JSON object"),
        (PodRun("[" * 100_000, 0), "is no JSON object"),
        (PodRun('{"checks": []}', 0), "checks: empty"),
        (PodRun('{"checks": [{"name": "a", "passed": "yes"}]}', 0), r"passed: must be true or false"),
        (PodRun('{"results": []}', 0), "results: unknown key"),
    ],
)
def test_results_that_are_none(pod: PodRun, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_result(pod)
