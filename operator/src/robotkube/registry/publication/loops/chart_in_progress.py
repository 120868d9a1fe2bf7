"""A chart of a submission while its suites run: which results count already, which came, which are still to come."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.charts.core.packing import published_digest
from robotkube.registry.evidence.core.statements import Artefact, Listing, SuiteResult, VerifiedStatement
from robotkube.registry.evidence.core.verification_policy import PLAIN_SUITES, SuiteRule, VerificationPolicy
from robotkube.registry.publication.core.report import ChartReport, SuiteReport
from robotkube.registry.publication.core.submissions import SubmittedChart
from robotkube.registry.suites.core.requests import Replaced


@dataclass
class ChartInProgress:
    """A chart of a submission while its suites run; suites by name. `attempt` is the submission's commit: a
    failed suite runs again for another one. `kept` are statements that count already, `states`, `reasons` and `since`
    (monotonic seconds) are of those that were asked of the runner, `ended` (RFC 3339) of those whose result came,
    `signed` are envelopes made in this process."""

    chart: SubmittedChart
    schema: str
    policy: VerificationPolicy
    attempt: str
    replaced: Replaced | None = None
    kept: dict[str, tuple[bytes, VerifiedStatement]] = field(default_factory=dict)
    summaries: list[tuple[bytes, VerifiedStatement]] = field(default_factory=list)
    results: dict[str, SuiteResult] = field(default_factory=dict)
    states: dict[str, str] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    since: dict[str, float] = field(default_factory=dict)
    ended: dict[str, str] = field(default_factory=dict)
    signed: dict[str, bytes] = field(default_factory=dict)
    evidence: str = ""

    @property
    def artefact(self) -> Artefact:
        """What is verified."""
        return self.chart.artefact

    @property
    def listing(self) -> Listing:
        """Its listing in the catalogue."""
        return Listing(published_digest(self.chart.spec, self.chart.images), sha256(self.schema.encode()))

    @property
    def missing(self) -> tuple[SuiteRule, ...]:
        """Suites without a kept statement and without a result."""
        return tuple(r for r in self.policy.suites if r.name not in self.kept and r.name not in self.results)

    def awaited(self, starting: bool) -> tuple[SuiteRule, ...]:
        """Missing suites whose results will come; without `starting` those only that are asked for already, or need no
        test namespace."""
        return tuple(r for r in self.missing if starting or r.name in PLAIN_SUITES or r.name in self.states)

    @property
    def plainly_wrong(self) -> bool:
        """Return whether a suite that needs no test namespace has not passed: the others need not be tried."""
        return any(self.results[name].outcome != "passed" for name in PLAIN_SUITES if name in self.results)

    def startable(self) -> tuple[SuiteRule, ...]:
        """Suites that hold a test namespace and may begin, which is when all that need none have passed."""
        plain = any(rule.name in PLAIN_SUITES for rule in self.missing)
        return () if plain or self.plainly_wrong else tuple(r for r in self.missing if r.name not in self.states)

    @property
    def passed(self) -> bool:
        """Return whether every suite of the policy passed."""
        return not self.missing and all(result.outcome == "passed" for result in self.results.values())

    def report(self) -> ChartReport:
        """The report that the comment shows."""
        return ChartReport(self.artefact, tuple(self._suite(rule) for rule in self.policy.suites), self.evidence)

    def _suite(self, rule: SuiteRule) -> SuiteReport:
        if rule.name in self.kept:
            seconds = _kept_seconds(self.kept[rule.name][1])
            return SuiteReport(rule.name, rule.version, "passed", seconds, note="kept result")
        result = self.results.get(rule.name)
        if result is None:
            state = self.states.get(rule.name, "waiting")
            return SuiteReport(rule.name, rule.version, state, note=self.reasons.get(rule.name, ""))
        ended = self.ended.get(rule.name, "")
        report = SuiteReport(rule.name, rule.version, result.outcome, result.seconds, ended=ended)
        return replace(report, failed=result.failed, reserved=result.reserved)


def _kept_seconds(statement: VerifiedStatement) -> float | None:
    """How long the run took, as its statement says."""
    configuration: Any = statement.statement.get("predicate", {}).get("configuration") or []
    for item in configuration:
        try:
            return float(item["annotations"]["seconds"])
        except (KeyError, TypeError, ValueError):
            continue
    return None
