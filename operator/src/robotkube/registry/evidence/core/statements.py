"""Evidence as values: results of suites, the statements about them, and whether they suffice.

    evidence/<chart>/<version>_<digest12>/<suite>.json      a signed statement: this suite passed on this digest
    evidence/<chart>/<version>_<digest12>/summary.json      a signed statement: the policy is met by exactly these

Statements are in-toto Statement v1 with the predicates test-result v0.1 (one per suite) and SLSA verification summary
v1 (one per policy). Signing is a port's business (`ports.evidence`); here nothing is trusted but what a
`VerifiedStatement` holds, and `assess` says with reasons whether it covers a chart version.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from robotkube.registry.charts.core.packing import build_tag
from robotkube.registry.evidence.core.verification_policy import SUMMARY, SuiteRule, VerificationPolicy

STATEMENT_TYPE = "https://in-toto.io/Statement/v1"
SUITE_PREDICATE = "https://in-toto.io/attestation/test-result/v0.1"
SUMMARY_PREDICATE = "https://slsa.dev/verification_summary/v1"
ENVELOPE_MEDIA_TYPE = "application/vnd.in-toto+json"  # payload type of envelopes, artifact type of attachments
SUITE_ANNOTATION = "robotkube.io/suite"  # of an attachment: the suite's name, or "summary"
PREDICATE_ANNOTATION = "robotkube.io/predicate"
FOLDER = "evidence"
NONE = "none"  # how trailers and annotations say that there is no evidence
PASSED, FAILED = "PASSED", "FAILED"
FINISHED = "suite-finished"  # the test that a run fails which did not come to its end
LEVEL = "ROBOTKUBE_VERIFIED"
CHECKS_MAX = 500
FAILED_MAX = 20
"""So many failed checks of a suite are shown."""

Outcome = Literal["passed", "failed", "unfinished"]


def attachment_annotations(name: str) -> dict[str, str]:
    """What the artefact of an envelope says about itself; `name` is a suite's, or that of the summary."""
    return {SUITE_ANNOTATION: name, PREDICATE_ANNOTATION: SUMMARY_PREDICATE if name == SUMMARY else SUITE_PREDICATE}


@dataclass(frozen=True)
class Check:
    """One check of a suite. A failed one says what was `found` and how to `fix` it, in plain words."""

    name: str
    passed: bool
    found: str = ""
    fix: str = ""


NOT_SHOWN = "not shown:"
"""The begin of what a check that passed says of what it has not shown."""


@dataclass(frozen=True)
class SuiteResult:
    """The result of a run of a suite; `unfinished`: it was cut off (time, size, a crash) and proves nothing."""

    suite: str
    version: str
    outcome: Outcome
    checks: tuple[Check, ...]
    seconds: float

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def reserved(self) -> tuple[Check, ...]:
        """The checks that passed, and say what they have not shown."""
        return tuple(check for check in self.checks if check.passed and NOT_SHOWN in check.found)


@dataclass(frozen=True)
class Artefact:
    """A chart version as evidence names it; `digest` is the OCI manifest digest, `platform` such as linux/amd64."""

    chart: str
    version: str
    digest: str
    platform: str

    @property
    def folder(self) -> str:
        """The folder of its evidence in the catalogue repository."""
        return f"{FOLDER}/{self.chart}/{build_tag(self.version, self.digest)}"


@dataclass(frozen=True)
class Listing:
    """What the catalogue says of a chart version in addition to its digest: the digests of its `entry`
    (`ChartVersion.entry`) and of the text of its values `schema`, which releases are checked by; empty where there is
    none."""

    entry: str = ""
    schema: str = ""


@dataclass(frozen=True)
class VerifiedStatement:
    """A statement whose envelope was verified: `envelope_digest` is `sha256:<hex>` of the envelope's bytes, `key_id`
    the trusted key that signed it."""

    statement: Mapping[str, Any]
    envelope_digest: str
    key_id: str


@dataclass(frozen=True)
class Assessment:
    """The judgement on the evidence of a chart version: `assured` when it covers the version. `evidence` is the summary
    envelope's digest (empty when there is none); `problems` are sentences, empty exactly when `assured`; `findings` are
    what each suite found and who signed it, as people read it."""

    assured: bool
    evidence: str = ""
    problems: tuple[str, ...] = ()
    findings: tuple[Mapping[str, Any], ...] = ()

    @property
    def explanation(self) -> str:
        """The problems as one text; empty when assured."""
        return "; ".join(self.problems)


def hexadecimal(digest: str) -> str:
    """`sha256:<hex>` without the algorithm, as statements write it."""
    return digest.removeprefix("sha256:")


def suite_statement(artefact: Artefact, policy_digest: str, result: SuiteResult) -> dict[str, Any]:
    """The statement that `result` was found on `artefact` under the policy.

    An unfinished run is a failed one, with the failed test `suite-finished`."""
    failed = [check.name for check in result.failed][:CHECKS_MAX]
    if result.outcome == "unfinished":
        failed.append(FINISHED)
    suite = {"name": result.suite, "version": result.version, "seconds": f"{result.seconds:.1f}"}
    predicate = {
        "result": PASSED if result.outcome == "passed" and not failed else FAILED,
        "configuration": [
            {"name": "policy", "digest": {"sha256": hexadecimal(policy_digest)}},
            {"name": "suite", "annotations": suite},
        ],
        "passedTests": [check.name for check in result.checks if check.passed][:CHECKS_MAX],
        "failedTests": failed,
    }
    return _statement(artefact, SUITE_PREDICATE, predicate)


def summary_statement(
    artefact: Artefact,
    policy: VerificationPolicy,
    policy_uri: str,
    resource_uri: str,
    verifier: str,
    verified_at: str,
    envelopes: Mapping[str, str],
    listing: Listing,
) -> dict[str, Any]:
    """The statement that `policy` is met by the suites' envelopes (`envelopes`: suite -> envelope digest), and that
    `listing` is what the catalogue says of the chart.

    `resource_uri` is `oci://<registry>/<organisation>/<chart>`, the digest is added here; `verified_at` RFC 3339, UTC,
    such as 2026-11-21T10:00:00Z. ValueError when an envelope is missing: such a summary must not exist."""
    missing = [rule.name for rule in policy.suites if rule.name not in envelopes]
    if missing:
        raise ValueError(f"no envelope of {', '.join(missing)}: there is nothing to summarise")
    predicate = {
        "verifier": {"id": verifier},
        "timeVerified": verified_at,
        "resourceUri": f"{resource_uri}@{artefact.digest}",
        "policy": {"uri": policy_uri, "digest": {"sha256": hexadecimal(policy.digest)}},
        "inputAttestations": [
            {"uri": rule.name, "digest": {"sha256": hexadecimal(envelopes[rule.name])}} for rule in policy.suites
        ],
        "verificationResult": PASSED,
        "verifiedLevels": [LEVEL],
    }
    return _statement(artefact, SUMMARY_PREDICATE, predicate, entry=listing.entry, schema=listing.schema)


def _statement(artefact: Artefact, kind: str, predicate: Mapping[str, Any], **more: str) -> dict[str, Any]:
    subject = {
        "name": artefact.chart,
        "digest": {"sha256": hexadecimal(artefact.digest)},
        "annotations": {"version": artefact.version, "platform": artefact.platform, **more},
    }
    return {"_type": STATEMENT_TYPE, "subject": [subject], "predicateType": kind, "predicate": predicate}


def assess(
    artefact: Artefact,
    policy: VerificationPolicy,
    status_evidence: str,
    statements: Mapping[str, VerifiedStatement | str],
    listing: Listing,
) -> Assessment:
    """Judge evidence: do `statements` prove that `artefact` meets `policy`, and that `listing` is what was verified?

    `statements` is suite name (or "summary") -> what verifying its envelope gave: the statement, or the sentence why
    the envelope is refused. `status_evidence` is the catalogue's `status.evidence`; empty means none is stated."""
    problems: list[str] = []
    for rule in policy.suites:
        problems += suite_problems(artefact, policy.digest, rule, statements.get(rule.name))
    summary = statements.get(SUMMARY)
    problems += _summary_problems(artefact, policy, summary, statements)
    evidence = summary.envelope_digest if isinstance(summary, VerifiedStatement) else ""
    if isinstance(summary, VerifiedStatement):
        problems += _listing_problems(artefact, summary, listing)
    if evidence and status_evidence != evidence:
        stated = status_evidence or "nothing"
        problems.append(f"status.evidence names {stated}, the summary is {evidence}; submit the chart again")
    findings = tuple(_finding(rule.name, statements.get(rule.name)) for rule in policy.suites)
    return Assessment(not problems, evidence, tuple(problems), findings)


def _finding(suite: str, verified: VerifiedStatement | str | None) -> Mapping[str, Any]:
    """What the statement of a suite says: `signed_by` is the trusted key, empty where no such statement is there."""
    if not isinstance(verified, VerifiedStatement):
        return {"suite": suite, "result": "none", "passed": 0, "failed": [], "signed_by": ""}
    predicate = mapping(verified.statement.get("predicate"))
    passed, failed = ([str(one) for one in _listed(predicate.get(name))] for name in ("passedTests", "failedTests"))
    result = str(predicate.get("result"))
    return {
        "suite": suite,
        "result": result,
        "passed": len(passed),
        "failed": failed[:FAILED_MAX],
        "signed_by": verified.key_id,
    }


def _listed(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list) else []


def lasting_problems(
    artefact: Artefact, status_evidence: str, entry: str, summary: VerifiedStatement | str | None
) -> Sequence[str]:
    """Why `summary` does not prove that `artefact` was verified with the `entry` (`ChartVersion.entry`, which covers
    its images), under whatever policy was in force then; empty when it does.

    What may be deployed anew is asked of `assess`, under the policy of today. What runs already was verified, and
    stays so when the policy changes: only a withdrawal ends that."""
    if summary is None:
        return ["summary: there is none"]
    if isinstance(summary, str):
        return [f"summary: {summary}"]
    if summary.statement.get("predicateType") != SUMMARY_PREDICATE:
        return [f"summary: it is no verification summary but {summary.statement.get('predicateType')!r}"]
    problems = [f"summary: {problem}" for problem in _verdict_problems(artefact, summary.statement)]
    signed = _subject_annotations(summary)
    if not entry or signed.get("entry") != entry:
        problems.append(f"the entry with its images is not what was verified ({entry}, not {signed.get('entry')})")
    if status_evidence != summary.envelope_digest:
        problems.append(f"status.evidence names {status_evidence or 'nothing'}, not {summary.envelope_digest}")
    return problems


def suite_problems(
    artefact: Artefact, policy_digest: str, rule: SuiteRule, evidence: VerifiedStatement | str | None
) -> Sequence[str]:
    """Why `evidence` does not prove that the suite of `rule` passed on `artefact` under the policy; empty when it does.

    A kept result counts exactly when this is empty."""
    what = f"suite {rule.name}"
    if evidence is None:
        return [f"{what}: there is no evidence; a missing suite is not a passed one"]
    if isinstance(evidence, str):
        return [f"{what}: {evidence}"]
    if evidence.statement.get("predicateType") != SUITE_PREDICATE:
        return [f"{what}: the evidence is no test result but {evidence.statement.get('predicateType')!r}"]
    predicate = mapping(evidence.statement.get("predicate"))
    problems = _subject_problems(evidence.statement, artefact)
    problems += _configuration_problems(predicate, rule, policy_digest)
    problems += result_problems(predicate)
    return [f"{what}: {problem}" for problem in problems]


def _subject_problems(statement: Mapping[str, Any], artefact: Artefact) -> list[str]:
    subjects = statement.get("subject")
    if not isinstance(subjects, list) or len(subjects) != 1:
        return ["the evidence must be about exactly one chart"]
    subject = mapping(subjects[0])
    annotations = mapping(subject.get("annotations"))
    digest = mapping(subject.get("digest")).get("sha256")
    problems = []
    if digest != hexadecimal(artefact.digest):
        problems.append(f"the evidence is about another digest (sha256:{digest}, not {artefact.digest})")
    if (subject.get("name"), annotations.get("version")) != (artefact.chart, artefact.version):
        named = f"{subject.get('name')} {annotations.get('version')}"
        problems.append(f"the evidence is about {named}, not {artefact.chart} {artefact.version}")
    if annotations.get("platform") != artefact.platform:
        problems.append(f"the evidence is for platform {annotations.get('platform')}, not {artefact.platform}")
    return problems


def _configuration_problems(predicate: Mapping[str, Any], rule: SuiteRule, policy_digest: str) -> list[str]:
    configuration = descriptors(predicate.get("configuration"), "name")
    problems = policy_problems(configuration.get("policy", {}), policy_digest)
    suite = mapping(configuration.get("suite", {}).get("annotations"))
    if suite.get("name") != rule.name:
        problems.append(f"the evidence is of suite {suite.get('name')!r}")
    elif suite.get("version") != rule.version:
        problems.append(f"the evidence is of version {suite.get('version')!r} of the suite, not {rule.version!r}")
    return problems


def policy_problems(descriptor: Mapping[str, Any], policy_digest: str) -> list[str]:
    """Why a statement was not made under the policy of that digest."""
    digest = mapping(descriptor.get("digest")).get("sha256")
    if digest == hexadecimal(policy_digest):
        return []
    return [f"the evidence was made under another policy (sha256:{digest}, not {policy_digest}); submit it again"]


def result_problems(predicate: Mapping[str, Any]) -> list[str]:
    """Why a test result is not a passed one."""
    failed = predicate.get("failedTests") or []
    failed = [str(name) for name in failed] if isinstance(failed, list) else [str(failed)]
    if FINISHED in failed:
        return ["it did not finish; an unfinished suite is not a passed one"]
    if failed:
        return [f"it failed ({', '.join(failed[:5])}{', ...' if len(failed) > 5 else ''})"]
    if predicate.get("result") != PASSED:
        return [f"its result is {predicate.get('result')!r}, not {PASSED}"]
    return []


def _summary_problems(
    artefact: Artefact,
    policy: VerificationPolicy,
    summary: VerifiedStatement | str | None,
    statements: Mapping[str, VerifiedStatement | str],
) -> list[str]:
    if summary is None:
        return ["summary: there is none; submit the chart again"]
    if isinstance(summary, str):
        return [f"summary: {summary}"]
    if summary.statement.get("predicateType") != SUMMARY_PREDICATE:
        return [f"summary: it is no verification summary but {summary.statement.get('predicateType')!r}"]
    predicate = mapping(summary.statement.get("predicate"))
    problems = policy_problems(mapping(predicate.get("policy")), policy.digest)
    problems += _verdict_problems(artefact, summary.statement)
    problems += _input_problems(predicate, policy, statements)
    return [f"summary: {problem}" for problem in problems]


def _verdict_problems(artefact: Artefact, statement: Mapping[str, Any]) -> list[str]:
    """Why a summary is not about `artefact`, or not that it passed."""
    predicate = mapping(statement.get("predicate"))
    problems = _subject_problems(statement, artefact)
    if predicate.get("verificationResult") != PASSED:
        problems.append(f"its result is {predicate.get('verificationResult')!r}, not {PASSED}")
    if not str(predicate.get("resourceUri", "")).endswith(f"/{artefact.chart}@{artefact.digest}"):
        problems.append(f"it is about {predicate.get('resourceUri')!r}, not this digest of {artefact.chart}")
    return problems


def _listing_problems(artefact: Artefact, summary: VerifiedStatement, listing: Listing) -> list[str]:
    """Differences between the catalogue now and when the chart was verified: users may write main."""
    signed = _subject_annotations(summary)
    files = {"entry": f"{artefact.version}.yaml", "schema": f"{artefact.version}.schema.json"}
    return [
        f"charts/{artefact.chart}/{files[name]} is not what was verified ({digest or 'missing'}, "
        f"not {signed.get(name) or 'any'}); restore it, or submit the chart again"
        for name, digest in (("entry", listing.entry), ("schema", listing.schema))
        if signed.get(name, "") != digest
    ]


def _subject_annotations(summary: VerifiedStatement) -> Mapping[str, Any]:
    subjects = summary.statement.get("subject")
    subject = mapping(subjects[0]) if isinstance(subjects, list) and subjects else {}
    return mapping(subject.get("annotations"))


def _input_problems(
    predicate: Mapping[str, Any], policy: VerificationPolicy, statements: Mapping[str, VerifiedStatement | str]
) -> list[str]:
    inputs = predicate.get("inputAttestations")
    listed = descriptors(inputs, "uri")
    problems = []
    for rule in policy.suites:
        statement = statements.get(rule.name)
        digest = mapping(listed.get(rule.name, {}).get("digest")).get("sha256")
        if digest is None:
            problems.append(f"it does not list suite {rule.name}")
        elif isinstance(statement, VerifiedStatement) and digest != hexadecimal(statement.envelope_digest):
            problems.append(f"it lists another envelope of suite {rule.name} (sha256:{digest})")
    if isinstance(inputs, list) and len(inputs) != len(policy.suites):
        problems.append(f"it lists {len(inputs)} suites, the policy asks for {len(policy.suites)}")
    return problems


def mapping(value: Any) -> Mapping[str, Any]:
    """`value` if it is a mapping, else an empty one."""
    return value if isinstance(value, Mapping) else {}


def descriptors(value: Any, key: str) -> dict[str, Mapping[str, Any]]:
    """Resource descriptors by their name or URI; the first of a name counts."""
    named: dict[str, Mapping[str, Any]] = {}
    for item in value if isinstance(value, list) else []:
        if isinstance(item, Mapping) and isinstance(item.get(key), str):
            named.setdefault(item[key], item)
    return named
