"""What had been verified of a chart: its suites with their results, as the signed statements have them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core.statements import FAILED, VerifiedStatement
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
        "suites": [_suite(name, found) for name, found in sorted(statements.items()) if name != SUMMARY],
        "problem": problem,
    }


def _suite(name: str, found: VerifiedStatement | str) -> Row:
    if isinstance(found, str):
        return {"suite": name, "version": "", "result": "NOT BELIEVED", "passed": [], "failed": [], "problem": found}
    predicate = _mapping(found.statement.get("predicate"))
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
