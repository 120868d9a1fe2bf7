"""What evidence covers: every rule, each with the sentence that a person reads."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import pytest

from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.evidence.core.statements import (
    FINISHED,
    Artefact,
    Check,
    Listing,
    SuiteResult,
    VerifiedStatement,
    assess,
    hexadecimal,
    suite_problems,
    suite_statement,
    summary_statement,
)
from robotkube.registry.evidence.core.verification_policy import PATH
from tests.stages.registry.signed_evidence import CHARTS_URL, POLICY, VERIFIED_AT, artefact, result

Found = dict[str, VerifiedStatement | str]
APP = artefact()
KEY = "0123456789abcdef"
LISTING = Listing(sha256(b"entry"), sha256(b"schema"))


def verified(statement: dict[str, Any], name: str) -> VerifiedStatement:
    return VerifiedStatement(statement, sha256(name.encode()), KEY)


def evidence(about: Artefact = APP) -> Found:
    """Complete: every suite and their summary."""
    statements: Found = {
        r.name: verified(suite_statement(about, POLICY.digest, result(r)), r.name) for r in POLICY.suites
    }
    digests = {rule.name: sha256(rule.name.encode()) for rule in POLICY.suites}
    uri = f"{CHARTS_URL}/app"
    statement = summary_statement(about, POLICY, PATH, uri, "robotkube-gate", VERIFIED_AT, digests, LISTING)
    return statements | {"summary": verified(statement, "summary")}


SUMMARY = sha256(b"summary")


def changed(found: Found, name: str, change: Callable[[dict[str, Any]], None]) -> Found:
    """One statement changed, as if it had been signed so."""
    before = found[name]
    assert isinstance(before, VerifiedStatement)
    statement = copy.deepcopy(dict(before.statement))
    change(statement)
    return found | {name: VerifiedStatement(statement, before.envelope_digest, KEY)}


def problems(found: Found, about: Artefact = APP, status_evidence: str = SUMMARY) -> tuple[str, ...]:
    assessment = assess(about, POLICY, status_evidence, found, LISTING)
    assert assessment.assured is (not assessment.problems)
    return assessment.problems


def test_complete_evidence_assures_and_names_the_summary() -> None:
    assessment = assess(APP, POLICY, SUMMARY, evidence(), LISTING)
    assert (assessment.assured, assessment.evidence, assessment.explanation) == (True, SUMMARY, "")


def test_what_suites_found_is_told_with_who_signed_it_also_where_it_does_not_suffice() -> None:
    first, second, *_ = POLICY.suites
    failing = changed(
        evidence(), first.name, lambda s: s["predicate"].update(result="FAILED", failedTests=["it-starts"])
    )
    findings = assess(APP, POLICY, SUMMARY, {**failing, second.name: "it is signed with key 'x'"}, LISTING).findings
    assert [finding["suite"] for finding in findings] == [rule.name for rule in POLICY.suites]
    told = [(f["result"], f["failed"], f["signed_by"]) for f in findings[:2]]
    assert told == [("FAILED", ["it-starts"], KEY), ("none", [], "")]
    broken = changed(evidence(), first.name, lambda s: s.update(predicate="no mapping"))
    assert assess(APP, POLICY, SUMMARY, broken, LISTING).findings[0]["passed"] == 0


@pytest.mark.parametrize(
    ("listing", "words"),
    [
        (Listing(sha256(b"changed"), LISTING.schema), "charts/app/0.1.0.yaml is not what was verified (sha256:"),
        (Listing(LISTING.entry, sha256(b"changed")), "charts/app/0.1.0.schema.json is not what was verified (sha256:"),
        (Listing(LISTING.entry), "charts/app/0.1.0.schema.json is not what was verified (missing, not sha256:"),
    ],
)
def test_what_was_changed_beside_the_evidence_is_in_doubt(listing: Listing, words: str) -> None:
    assessment = assess(APP, POLICY, SUMMARY, evidence(), listing)
    assert not assessment.assured
    assert words in assessment.explanation


def test_a_summary_that_says_nothing_of_the_entry_proves_nothing_of_it() -> None:
    def silent(statement: dict[str, Any]) -> None:
        del statement["subject"][0]["annotations"]["entry"]

    assert "0.1.0.yaml is not what was verified" in problems(changed(evidence(), "summary", silent))[0]


@pytest.mark.parametrize("suite", [rule.name for rule in POLICY.suites])
def test_a_missing_suite_is_not_a_passed_one(suite: str) -> None:
    statements = evidence()
    del statements[suite]
    assert problems(statements) == (f"suite {suite}: there is no evidence; a missing suite is not a passed one",)


def test_a_failed_suite_is_named_with_what_failed() -> None:
    rule = POLICY.suites[0]
    failed = suite_statement(APP, POLICY.digest, result(rule, "probes", "limits"))
    assert problems(evidence() | {"static": verified(failed, "static")}) == (
        "suite static: it failed (probes, limits)",
    )


def test_a_run_that_was_cut_off_proves_nothing() -> None:
    rule = POLICY.suites[2]
    cut = SuiteResult(rule.name, rule.version, "unfinished", (Check("installs", True),), 240.0)
    statement = suite_statement(APP, POLICY.digest, cut)
    assert statement["predicate"]["result"] == "FAILED"
    assert statement["predicate"]["failedTests"] == [FINISHED]
    assert problems(evidence() | {"install": verified(statement, "install")}) == (
        "suite install: it did not finish; an unfinished suite is not a passed one",
    )


def test_a_result_that_calls_itself_passed_with_a_failed_check_is_signed_as_failed() -> None:
    odd = SuiteResult("static", "1", "passed", (Check("probes", False, "none", "add one"),), 1.0)
    assert suite_statement(APP, POLICY.digest, odd)["predicate"]["result"] == "FAILED"


def test_a_result_other_than_passed_does_not_count() -> None:
    statements = changed(evidence(), "static", lambda s: s["predicate"].update(result="WARNED"))
    assert problems(statements) == ("suite static: its result is 'WARNED', not PASSED",)


def test_evidence_of_another_digest_is_refused_in_all_its_pieces() -> None:
    other = artefact(content="one byte more")
    refused = problems(evidence(), other)
    assert len([p for p in refused if "is about another digest" in p]) == len(POLICY.suites) + 1
    assert f"suite static: the evidence is about another digest ({APP.digest}, not {other.digest})" in refused


def test_evidence_of_another_chart_or_version_is_refused() -> None:
    later = Artefact("app", "0.2.0", APP.digest, APP.platform)
    assert "suite static: the evidence is about app 0.1.0, not app 0.2.0" in problems(evidence(), later)


def test_evidence_for_another_platform_is_refused() -> None:
    arm = Artefact(APP.chart, APP.version, APP.digest, "linux/arm64")
    assert "suite install: the evidence is for platform linux/amd64, not linux/arm64" in problems(evidence(), arm)


def test_evidence_under_another_policy_is_refused() -> None:
    before = sha256(b"the policy before")
    statement = suite_statement(APP, before, result(POLICY.suites[1]))
    (problem,) = problems(evidence() | {"images": verified(statement, "images")})
    assert problem.startswith(f"suite images: the evidence was made under another policy ({before}, not")


def test_evidence_of_another_suite_or_version_of_it_is_refused() -> None:
    statement = suite_statement(APP, POLICY.digest, result(POLICY.suites[0]))
    assert problems(evidence() | {"images": verified(statement, "images")}) == (
        "suite images: the evidence is of suite 'static'",
    )
    old = suite_statement(APP, POLICY.digest, SuiteResult("install", "1", "passed", (), 1.0))
    assert problems(evidence() | {"install": verified(old, "install")}) == (
        "suite install: the evidence is of version '1' of the suite, not '2'",
    )


def test_a_refused_envelope_is_doubt_with_its_reason() -> None:
    reason = "it is signed with key 'feed', which is not trusted here (trusted: none)"
    assert problems(evidence() | {"static": reason}) == (f"suite static: {reason}",)
    assert f"summary: {reason}" in problems(evidence() | {"summary": reason})


def test_a_summary_in_place_of_a_suite_and_the_reverse_are_refused() -> None:
    statements = evidence()
    swapped = statements | {"static": statements["summary"], "summary": statements["static"]}
    texts = problems(swapped)
    assert any(text.startswith("suite static: the evidence is no test result but") for text in texts)
    assert any(text.startswith("summary: it is no verification summary but") for text in texts)


def test_without_a_summary_nothing_is_assured() -> None:
    statements = evidence()
    del statements["summary"]
    assert problems(statements) == ("summary: there is none; submit the chart again",)
    assert assess(APP, POLICY, "", {}, LISTING).evidence == ""


@pytest.mark.parametrize("stated", ["", sha256(b"another summary")])
def test_the_catalogue_must_name_this_summary(stated: str) -> None:
    (problem,) = problems(evidence(), status_evidence=stated)
    assert problem == f"status.evidence names {stated or 'nothing'}, the summary is {SUMMARY}; submit the chart again"


def test_a_summary_that_lists_another_envelope_is_refused() -> None:
    other = hexadecimal(sha256(b"an envelope from elsewhere"))
    statements = changed(
        evidence(), "summary", lambda s: s["predicate"]["inputAttestations"][0]["digest"].update(sha256=other)
    )
    assert problems(statements) == (f"summary: it lists another envelope of suite static (sha256:{other})",)


def test_a_summary_that_leaves_a_suite_out_or_adds_one_is_refused() -> None:
    less = changed(evidence(), "summary", lambda s: s["predicate"]["inputAttestations"].pop())
    assert problems(less) == (
        "summary: it does not list suite install",
        "summary: it lists 2 suites, the policy asks for 3",
    )
    more = changed(evidence(), "summary", lambda s: s["predicate"]["inputAttestations"].append({"uri": "own"}))
    assert problems(more) == ("summary: it lists 4 suites, the policy asks for 3",)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"verificationResult": "FAILED"}, "summary: its result is 'FAILED', not PASSED"),
        ({"resourceUri": f"oci://h/verified/other@{APP.digest}"}, "summary: it is about 'oci://h/verified/other@"),
        ({"policy": {}}, "summary: the evidence was made under another policy"),
    ],
)
def test_a_summary_says_passed_for_this_chart_and_policy(change: dict[str, Any], expected: str) -> None:
    (problem,) = problems(changed(evidence(), "summary", lambda s: s["predicate"].update(change)))
    assert problem.startswith(expected)


@pytest.mark.parametrize("value", [None, [], {}, "text", 7, [None], [[]], [{}], {"a": []}])
def test_statements_of_another_form_are_doubt_and_never_a_crash(value: Any) -> None:
    for name in ("static", "summary"):
        before = evidence()[name]
        assert isinstance(before, VerifiedStatement)
        for key in ("subject", "predicate", "predicateType"):
            assert problems(changed(evidence(), name, lambda s, key=key: s.update({key: value})))  # type: ignore[misc]
        for key in before.statement["predicate"]:
            if key not in ("verifier", "timeVerified", "verifiedLevels", "passedTests"):
                statements = changed(evidence(), name, lambda s, key=key: s["predicate"].update({key: value}))  # type: ignore[misc]
                assert problems(statements) or (key == "failedTests" and not value)


def test_a_kept_result_counts_by_digest_policy_and_suite_version_only() -> None:
    rule = POLICY.suites[0]
    kept = evidence()["static"]
    assert suite_problems(APP, POLICY.digest, rule, kept) == []
    assert suite_problems(artefact(content="changed"), POLICY.digest, rule, kept)
    assert suite_problems(APP, sha256(b"other"), rule, kept)
    assert suite_problems(APP, POLICY.digest, POLICY.suites[1], kept)


def test_a_summary_of_nothing_cannot_be_made() -> None:
    with pytest.raises(ValueError, match="no envelope of static, images, install"):
        summary_statement(APP, POLICY, PATH, CHARTS_URL, "gate", VERIFIED_AT, {}, LISTING)


def test_evidence_has_a_folder_of_its_own_per_digest() -> None:
    assert APP.folder == f"evidence/app/0.1.0_{hexadecimal(APP.digest)[:12]}"
