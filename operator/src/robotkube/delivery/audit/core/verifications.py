"""What had been verified: of a chart its suites with their results, of an application what it was tried with, as the
signed statements have them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.registry.catalogue.core.applications import Application
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core.application_statements import tried_charts
from robotkube.registry.evidence.core.statements import FAILED, NONE, VerifiedStatement
from robotkube.registry.evidence.core.verification_policy import SUMMARY

Row = dict[str, Any]


def verification_row(
    chart: ChartReference,
    evidence: str,
    version: ChartVersion | None,
    statements: Mapping[str, VerifiedStatement | str],
    decided_by: str,
) -> Row:
    """One chart: who signed, when it was verified, every suite with its result; `problem` says why that does not hold,
    empty when it does. `statements` are suite (or "summary") -> its statement, or why that is not believed."""
    summary = statements.get(SUMMARY)
    same = version is not None and version.digest == chart.digest
    problem = "" if same else "the catalogue did not have this digest"
    if version is not None and same and not version.assured:
        problem = version.evidence_problem
    predicate = _mapping(summary.statement.get("predicate")) if isinstance(summary, VerifiedStatement) else {}
    return {
        "chart": chart.name,
        "version": chart.version,
        "digest": chart.digest,
        "evidence": evidence,
        "images": list(version.image_references) if version and same else [],
        "catalogue": decided_by,
        "key": summary.key_id if isinstance(summary, VerifiedStatement) else "",
        "verified_at": str(predicate.get("timeVerified", "")),
        "policy": f"sha256:{_mapping(_mapping(predicate.get('policy')).get('digest')).get('sha256', '')}"
        if predicate
        else "",
        "suites": [_suite(name, outcome) for name, outcome in sorted(statements.items()) if name != SUMMARY],
        "problem": problem,
    }


def application_row(
    name: str, application: Application | None, outcome: VerifiedStatement | str | None, decided_by: str
) -> Row:
    """One application that tasks asked for: its statement, who signed it, with which charts it had been tried;
    `problem` says why that does not hold, empty when it does. `outcome` is the statement that was there, or why it is
    not believed."""
    problem = "the catalogue did not have it" if application is None else application.evidence_problem
    signed = outcome if isinstance(outcome, VerifiedStatement) else None
    return {
        "application": name,
        "digest": application.digest if application else "",
        "evidence": application.evidence if application and application.evidence else NONE,
        "catalogue": decided_by,
        "key": signed.key_id if signed else "",
        "charts": [f"{chart}@{digest}" for chart, digest in sorted(tried_charts(signed).items())] if signed else [],
        "problem": "" if application is not None and application.assured else problem,
    }


def _suite(name: str, outcome: VerifiedStatement | str) -> Row:
    if isinstance(outcome, str):
        return {"suite": name, "version": "", "result": "NOT BELIEVED", "passed": [], "failed": [], "problem": outcome}
    predicate = _mapping(outcome.statement.get("predicate"))
    configuration = predicate.get("configuration")
    version = ""
    for item in configuration if isinstance(configuration, list) else []:
        if _mapping(item).get("name") == "suite":
            version = str(_mapping(_mapping(item).get("annotations")).get("version", ""))
    return {
        "suite": name,
        "version": version,
        "result": str(predicate.get("result", FAILED)),
        "passed": _words(predicate.get("passedTests")),
        "failed": _words(predicate.get("failedTests")),
        "problem": "",
    }


def _words(value: Any) -> list[str]:
    return [str(word) for word in value] if isinstance(value, list) else []


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
