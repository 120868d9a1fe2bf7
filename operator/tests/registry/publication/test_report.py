"""The gate's report: verdict first, every failure with finding and fix, nothing of what others wrote as markup."""

import pytest

from robotkube.registry.evidence.core.statements import Artefact, Check
from robotkube.registry.publication.core.report import (
    CHECKING,
    MARKER,
    REFUSED,
    REPORT_CHARACTERS_MAX,
    TEXT_CHARACTERS_MAX,
    UNCHANGED,
    VERIFIED,
    WAITING,
    ChartReport,
    Report,
    SuiteReport,
    plain,
    quoted,
    readable_text,
    report_text,
)
from robotkube.registry.publication.core.report_results import ReportedResult, reported_results
from robotkube.registry.suites.core.pod_descriptions import describe_pod, last_lines

ARTEFACT = Artefact("relay", "0.1.0", "sha256:" + "1" * 64, "linux/amd64")
PASSED = SuiteReport("static", "1", "passed", 2.13)
FAILED = SuiteReport(
    "install", "2", "failed", 30.0, failed=(Check("stops", False, "killed after 30 s", "handle TERM"),)
)


def report(verdict: str, *suites: SuiteReport, **more: object) -> str:
    charts = (ChartReport(ARTEFACT, suites, str(more.pop("evidence", ""))),) if suites else ()
    return report_text(Report(verdict, "relay 0.1.0", "c" * 40, "oci://forge/verified", charts=charts, **more))  # type: ignore[arg-type]


def test_a_refusal_names_suite_check_finding_and_fix() -> None:
    text = report(REFUSED, PASSED, FAILED)
    assert text.startswith(
        f"{MARKER}\n## Refused: relay 0.1.0\n\nNothing was published. install of relay failed. Change"
    )
    assert "| static 1 | passed | 2.1 s |  |" in text
    assert "| install 2 | **failed** | 30.0 s |  |" in text
    assert "**install failed:**\n\n- stops\n  - found: `killed after 30 s`\n  - do: handle TERM\n" in text
    assert "published as" not in text


def test_what_a_passed_check_has_not_shown_stands_below_the_suites() -> None:
    check = Check("takes-changed-settings", True, "a pod that stayed; not shown: values.greeting")
    text = report(VERIFIED, SuiteReport("install", "2", "passed", 30.0, reserved=(check,)))
    assert "- install, takes-changed-settings: `a pod that stayed; not shown: values.greeting`\n" in text


@pytest.mark.parametrize("state", ["waiting", "queued"])
def test_suites_that_a_refusal_leaves_out_did_not_run(state: str) -> None:
    suite = SuiteReport("install", "2", state)
    assert "| install 2 | not run |  |  |" in report(REFUSED, PASSED, suite)
    assert f"| install 2 | {state} |  |  |" in report(CHECKING, PASSED, suite)


def test_a_verified_chart_says_where_it_and_its_evidence_are() -> None:
    text = report(VERIFIED, PASSED, evidence="sha256:" + "e" * 64, applications=("applications/relaying.yaml",))
    assert "It is published the moment this pull request shows as merged." in text
    assert f"in this repository below `evidence/relay/0.1.0_{'1' * 12}/`" in text
    assert f"published as `oci://forge/verified/relay@sha256:{'1' * 64}`" in text
    assert "Applications: `applications/relaying.yaml`" in text


def test_the_other_verdicts() -> None:
    assert "1 of 2 suites passed so far." in report(CHECKING, PASSED, SuiteReport("install", "1", "queued"))
    assert "It waits: the runner is away" in report(WAITING, waiting_for="the runner is away")
    assert "The catalogue has exactly this already" in report(UNCHANGED)
    assert "install of relay did not finish" in report(REFUSED, SuiteReport("install", "1", "unfinished"))


@pytest.mark.parametrize(
    "evil",
    ["@everyone", "<script>", "[x](http://evil)", "![x](http://evil)", "a\n\n## Verified: all", "`code`", "| a |"],
)
def test_what_charts_say_is_never_markup(evil: str) -> None:
    for text in (plain(evil), quoted(evil)):
        assert "\n" not in text
    shown = plain(evil)
    assert "@" not in shown
    assert "<" not in shown
    assert "](" not in shown.replace("\\]", "")
    assert "`" not in quoted(evil)[1:-1]


def test_a_report_is_bounded() -> None:
    checks = tuple(Check(f"check {n}", False, "x" * 10_000, "y" * 10_000) for n in range(500))
    suites = [SuiteReport(f"suite-{n}", "1", "failed", failed=checks) for n in range(16)]
    text = report(REFUSED, *suites, problems=("z" * 5000,) * 500)
    assert len(text) <= REPORT_CHARACTERS_MAX + 20
    assert "and 450 more" in text


def test_the_last_line_of_a_log_survives_the_cut() -> None:
    """What the suites say of a pod that ends again and again: a traceback names its cause in the last line."""
    line = "NameError: name 'offset' is not defined"
    probe = 'Readiness probe failed: Get "http://10.244.3.17:8081/readyz": dial tcp 10.244.3.17:8081: connect: refused'
    log = ["Traceback", *(f"File '/opt/robotkube/lib/python3.11/site-packages/rclpy/{n}.py'" for n in range(11)), line]
    status = {"name": "main", "restartCount": 2, "state": {"waiting": {"reason": "CrashLoopBackOff"}}}
    status["lastState"] = {"terminated": {"exitCode": 1, "reason": "Error"}}
    pod = {"metadata": {"name": "relay-1"}, "status": {"containerStatuses": [status]}}
    events = [{"type": "Warning", "reason": "Unhealthy", "message": f"{probe} {n}"} for n in range(5)]
    words = "\n".join(["Deployment relay cannot get ready", *describe_pod(pod, events), *last_lines("\n".join(log))])
    text = report(REFUSED, SuiteReport("install", "3", "failed", failed=(Check("becomes-ready", False, words, "do"),)))
    [shown] = [one for one in text.splitlines() if one.startswith("  - found: ")]
    assert shown.endswith(f"{line}`")
    assert "container main was restarted 2 times; it ended with 1 (Error)" in shown
    assert len(shown) <= len("  - found: ``") + TEXT_CHARACTERS_MAX


def test_a_terminal_sees_plain_text() -> None:
    text = readable_text(report(REFUSED, problems=("charts/a_b.yaml: <nothing> `here` @all [x]",)))
    assert "- charts/a_b.yaml: <nothing> `here` @all [x]" in text
    assert MARKER not in text


def test_results_are_read_out_of_the_report() -> None:
    suites = (
        SuiteReport("static", "2", "passed", 2.13, ended="2026-11-26T06:13:26Z"),
        SuiteReport("images", "2", "passed", 1.0, note="kept result"),
        SuiteReport("interface", "1", "unfinished", failed=(Check("suite-finished", False, "| x | passed |", "do"),)),
        SuiteReport(
            "install", "2", "failed", 4.0, failed=(Check("becomes_ready", False, "\n### a\n| a b | passed | |", "do"),)
        ),
        SuiteReport("own", "1", "queued", note="2 runs wait before it"),
    )
    results = reported_results(report(CHECKING, *suites))
    assert results == [
        ReportedResult("relay 0.1.0", "static 2", "passed", 2.1, "2026-11-26T06:13:26Z"),
        ReportedResult("relay 0.1.0", "images 2", "passed", 1.0),
        ReportedResult("relay 0.1.0", "interface 1", "unfinished", checks=("suite-finished",)),
        ReportedResult("relay 0.1.0", "install 2", "failed", 4.0, checks=("becomes_ready",)),
    ]
    assert reported_results("") == []
