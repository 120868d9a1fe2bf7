"""Statements about applications: each was composed for samples of its parameters, and what came out was checked.

    evidence/applications/<application>.json       a signed statement about the text of applications/<application>.yaml

The form is that of a suite's result (in-toto Statement v1, test-result v0.1); the subject is the application's document
by the digest of its text. What was tried is a sample: that a release runs verified images only is checked again, by
manager and gate, on the release itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core.statements import (
    FOLDER,
    PASSED,
    STATEMENT_TYPE,
    SUITE_PREDICATE,
    VerifiedStatement,
    descriptors,
    hexadecimal,
    mapping,
    policy_problems,
    result_problems,
)

TRIAL = "composition"  # the name of the suite in a statement
TRIAL_VERSION = "1"  # raised when more is checked: what older code signed does not count then
KIND = "Application"
CHECKS = ("composes", "values", "images", "objects")  # what a trial that passed has passed
MISSING = "there is no evidence that it was composed and checked; publish it again"

_KIND_ANNOTATION = "kind"


@dataclass(frozen=True)
class TrialResult:
    """What a trial of an application gave: `problems` are sentences for its author, `charts` the versions whose
    releases were rendered, `samples` how many sets of parameters were tried, `releases` how many different releases
    they gave. One that is not `finished` met its bounds, which is a problem as well."""

    problems: tuple[str, ...] = ()
    charts: tuple[ChartReference, ...] = ()
    samples: int = 0
    releases: int = 0
    finished: bool = True

    @property
    def passed(self) -> bool:
        """Return whether nothing speaks against the application."""
        return not self.problems


@dataclass(frozen=True)
class ApplicationAssessment:
    """The judgement on an application's statement: `evidence` is the digest of the envelope that is there, whatever it
    proves, empty when there is none; `problems` say why it does not hold, empty when it does."""

    evidence: str = ""
    problems: tuple[str, ...] = (MISSING,)

    @property
    def assured(self) -> bool:
        """Return whether the statement covers the application as it stands."""
        return not self.problems


def statement_path(application: str) -> str:
    """The path of the statement about an application in the catalogue repository."""
    return f"{FOLDER}/applications/{application}.json"


def document_digest(text: str) -> str:
    """The digest of an application's document."""
    return sha256(text.encode("utf-8", "surrogatepass"))


def application_statement(name: str, text: str, policy_digest: str, result: TrialResult) -> dict[str, Any]:
    """The statement that the application `name`, whose document is `text`, passed its trial under the policy. The same
    trial gives the same statement. ValueError when it did not pass: such a statement must not exist."""
    if not result.passed:
        raise ValueError(f"application {name} did not pass: {result.problems[0]}")
    counts = {"samples": str(result.samples), "releases": str(result.releases)}
    predicate = {
        "result": PASSED,
        "configuration": [
            {"name": "policy", "digest": {"sha256": hexadecimal(policy_digest)}},
            {"name": "suite", "annotations": {"name": TRIAL, "version": TRIAL_VERSION, **counts}},
            *(
                {"name": f"{chart.name}@{chart.version}", "digest": {"sha256": hexadecimal(chart.digest)}}
                for chart in sorted(result.charts)
            ),
        ],
        "passedTests": list(CHECKS),
        "failedTests": [],
    }
    subject = {
        "name": name,
        "digest": {"sha256": hexadecimal(document_digest(text))},
        "annotations": {_KIND_ANNOTATION: KIND},
    }
    return {"_type": STATEMENT_TYPE, "subject": [subject], "predicateType": SUITE_PREDICATE, "predicate": predicate}


def assess_application(
    name: str, text: str, policy_digest: str, envelope_digest: str, evidence: VerifiedStatement | str
) -> ApplicationAssessment:
    """Judge the envelope of that digest: `evidence` is its statement, or the sentence why it is refused. It has to be
    about exactly this document, passed, under this policy, by the trial of this code."""
    if isinstance(evidence, str):
        return ApplicationAssessment(envelope_digest, (f"the evidence cannot be believed: {evidence}",))
    problems = list(document_problems(name, text, evidence))
    if not problems:
        configuration = descriptors(_predicate(evidence).get("configuration"), "name")
        problems += policy_problems(configuration.get("policy", {}), policy_digest)
        version = mapping(configuration.get("suite", {}).get("annotations")).get("version")
        if version != TRIAL_VERSION:
            problems.append(f"the evidence is of version {version!r} of the trial, not {TRIAL_VERSION!r}")
    return ApplicationAssessment(envelope_digest, tuple(problems))


def document_problems(name: str, text: str, evidence: VerifiedStatement) -> Sequence[str]:
    """Why `evidence` does not say that exactly this document passed a trial, under whatever policy and code."""
    statement = evidence.statement
    if statement.get("predicateType") != SUITE_PREDICATE:
        return [f"the evidence is no test result but {statement.get('predicateType')!r}"]
    subjects = statement.get("subject")
    subject = mapping(subjects[0]) if isinstance(subjects, list) and len(subjects) == 1 else {}
    suite = mapping(descriptors(_predicate(evidence).get("configuration"), "name").get("suite", {}).get("annotations"))
    if mapping(subject.get("annotations")).get(_KIND_ANNOTATION) != KIND or suite.get("name") != TRIAL:
        return ["the evidence is not about an application"]
    if subject.get("name") != name:
        return [f"the evidence is about application {subject.get('name')!r}, not {name!r}"]
    digest = f"sha256:{mapping(subject.get('digest')).get('sha256')}"
    if digest != document_digest(text):
        return [
            f"applications/{name}.yaml is not what was verified ({document_digest(text)}, not {digest}); restore it, "
            "or publish it again"
        ]
    return result_problems(_predicate(evidence))


def tried_charts(evidence: VerifiedStatement) -> Mapping[str, str]:
    """The charts that an application was tried with, as the statement says: `<name>@<version>` -> digest."""
    configuration = descriptors(_predicate(evidence).get("configuration"), "name")
    return {
        name: f"sha256:{mapping(item.get('digest')).get('sha256')}"
        for name, item in configuration.items()
        if "@" in name
    }


def _predicate(evidence: VerifiedStatement) -> Mapping[str, Any]:
    return mapping(evidence.statement.get("predicate"))
