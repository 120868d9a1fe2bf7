"""What a statement about an application covers: every rule, each with the sentence that a person reads."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core import application_statements as statements
from robotkube.registry.evidence.core.application_statements import (
    ApplicationAssessment,
    TrialResult,
    application_statement,
    assess_application,
    document_digest,
    statement_path,
    tried_charts,
)
from robotkube.registry.evidence.core.statements import VerifiedStatement, suite_problems, suite_statement
from tests.stages.registry.signed_evidence import POLICY, artefact, result, signing_key, trusting

TEXT = "kind: Application\n"
CHART = ChartReference("relay", "0.1.0", "sha256:" + "1" * 64)
PASSED = TrialResult((), (CHART,), 3, 5)
ENVELOPE = "sha256:" + "e" * 64


def statement(name: str = "relaying", text: str = TEXT, policy: str = POLICY.digest) -> dict[str, Any]:
    return application_statement(name, text, policy, PASSED)


def judged(found: dict[str, Any], name: str = "relaying", text: str = TEXT) -> ApplicationAssessment:
    verified = VerifiedStatement(found, ENVELOPE, "key")
    return assess_application(name, text, POLICY.digest, ENVELOPE, verified)


def test_a_passed_trial_assures_exactly_this_document() -> None:
    assert judged(statement()) == ApplicationAssessment(ENVELOPE, ())
    assert judged(statement()).assured
    assert statement_path("relaying") == "evidence/applications/relaying.json"


def test_an_application_edited_after_signing_is_named_with_both_digests() -> None:
    edited = TEXT + "# one more word\n"
    assert judged(statement(), text=edited).problems == (
        f"applications/relaying.yaml is not what was verified ({document_digest(edited)}, not "
        f"{document_digest(TEXT)}); restore it, or publish it again",
    )


def test_a_statement_of_another_application_is_refused_also_when_the_text_is_the_same() -> None:
    assert judged(statement("other")).problems == ("the evidence is about application 'other', not 'relaying'",)


def test_another_policy_and_another_trial_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    other = "sha256:" + "9" * 64
    assert judged(statement(policy=other)).problems == (
        f"the evidence was made under another policy ({other}, not {POLICY.digest}); submit it again",
    )
    older = statement()
    monkeypatch.setattr(statements, "TRIAL_VERSION", "2")
    assert judged(older).problems == ("the evidence is of version '1' of the trial, not '2'",)


def _failed(found: dict[str, Any]) -> None:
    found["predicate"]["failedTests"] = ["images"]


def _two_subjects(found: dict[str, Any]) -> None:
    found["subject"] *= 2


def _no_kind(found: dict[str, Any]) -> None:
    found["subject"][0]["annotations"] = {}


def _other_suite(found: dict[str, Any]) -> None:
    found["predicate"]["configuration"][1]["annotations"]["name"] = "static"


def _no_predicate(found: dict[str, Any]) -> None:
    found["predicate"] = None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_failed, "it failed (images)"),
        (_two_subjects, "the evidence is not about an application"),
        (_no_kind, "the evidence is not about an application"),
        (_other_suite, "the evidence is not about an application"),
        (_no_predicate, "the evidence is not about an application"),
    ],
)
def test_what_a_statement_does_not_say_is_not_believed(change: Callable[[dict[str, Any]], None], words: str) -> None:
    changed = copy.deepcopy(statement())
    change(changed)
    assert judged(changed).problems == (words,)


def test_evidence_of_a_chart_is_none_of_an_application_and_the_reverse() -> None:
    rule = POLICY.suites[0]
    of_chart = suite_statement(artefact("relaying"), POLICY.digest, result(rule))
    assert judged(of_chart).problems == ("the evidence is not about an application",)
    about = replace(artefact("relaying"), digest=document_digest(TEXT))
    of_application = VerifiedStatement(statement(), ENVELOPE, "key")
    assert suite_problems(about, POLICY.digest, rule, of_application)


def test_an_envelope_that_is_not_believed_is_there_all_the_same() -> None:
    assessment = assess_application("relaying", TEXT, POLICY.digest, ENVELOPE, "its signature does not fit")
    assert assessment == ApplicationAssessment(
        ENVELOPE, ("the evidence cannot be believed: its signature does not fit",)
    )
    assert ApplicationAssessment().problems == (
        "there is no evidence that it was composed and checked; publish it again",
    )
    assert ApplicationAssessment().evidence == ""


def test_the_same_trial_is_signed_by_the_same_bytes_which_verify(tmp_path: Path) -> None:
    key = signing_key(tmp_path / "key")
    envelope = key.sign(statement())
    assert envelope == key.sign(statement())
    verified = trusting(tmp_path / "keys", key).verify(envelope)
    assert assess_application("relaying", TEXT, POLICY.digest, verified.envelope_digest, verified).assured
    assert tried_charts(verified) == {"relay@0.1.0": CHART.digest}


def test_a_trial_that_did_not_pass_is_not_signed() -> None:
    with pytest.raises(ValueError, match="application relaying did not pass: it is wrong"):
        application_statement("relaying", TEXT, POLICY.digest, TrialResult(("it is wrong",)))
