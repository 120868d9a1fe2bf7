"""Verification of a submitted chart: it keeps results by digest, policy and suite version, asks the suite-runner for
those that are missing, signs them and attaches them to the chart's digest.

Nothing but the OCI registry and the runner remembers anything: a gate that starts again finds what was attached and
asks the runner for the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.charts.ports import ChartRegistry
from robotkube.registry.evidence.core.statements import (
    ENVELOPE_MEDIA_TYPE,
    SUMMARY_PREDICATE,
    Check,
    SuiteResult,
    VerifiedStatement,
    assess,
    attachment_annotations,
    suite_problems,
    suite_statement,
    summary_statement,
)
from robotkube.registry.evidence.core.verification_policy import (
    PATH,
    SUMMARY,
    SuiteRule,
)
from robotkube.registry.evidence.ports import Signer, Verifier
from robotkube.registry.publication.core.submissions import VerifiedChart
from robotkube.registry.publication.loops.chart_in_progress import ChartInProgress
from robotkube.registry.suites.core.requests import SuiteRequest
from robotkube.registry.suites.ports.suites import SuiteRunner

QUEUE_SECONDS_MAX = 3600.0  # a suite may wait this long for its turn
MARGIN_SECONDS = 60.0  # beyond a rule's seconds, for the runner to clean up and report it
ENVELOPES_READ_MAX = 200  # of one chart


@dataclass(frozen=True)
class VerifyingSettings:
    """Settings of verifying: `staging`, `verified`, organisations of the OCI registry; `charts_url` is that of the
    latter (`oci://host/organisation`), `policy_uri` names the policy in summaries, `verifier` who verifies."""

    staging: str
    verified: str
    charts_url: str
    policy_uri: str
    verifier: str


class ChartVerification:
    """Kept results, runs, signatures, attachments. `monotonic` gives seconds, `now` the time in UTC as RFC 3339."""

    def __init__(
        self,
        oci_registry: ChartRegistry,
        signer: Signer,
        verifier: Verifier,
        runner: SuiteRunner,
        settings: VerifyingSettings,
        monotonic: Callable[[], float],
        now: Callable[[], str],
    ) -> None:
        self._oci_registry = oci_registry
        self._signer = signer
        self._verifier = verifier
        self._runner = runner
        self._settings = settings
        self._monotonic = monotonic
        self._now = now

    def begin(self, underway: ChartInProgress, carried: Iterable[bytes]) -> None:
        """Collect the results that count already: attached in the OCI registry, then `carried` by the submission."""
        self._verifier.trusted()
        chart = underway.chart
        repositories = [f"{self._settings.verified}/{chart.chart}", f"{self._settings.staging}/{chart.chart}"]
        attached = [
            attachment.data
            for where in repositories
            for attachment in self._oci_registry.attachments(where, chart.digest)
        ]
        envelopes = dict.fromkeys([*attached, *carried])
        for envelope in list(envelopes)[:ENVELOPES_READ_MAX]:
            self._keep(underway, envelope)

    def _keep(self, underway: ChartInProgress, envelope: bytes) -> None:
        try:
            statement = self._verifier.verify(envelope)
        except InputError:
            return  # not signed by a key that counts: as if it were not there
        if statement.statement.get("predicateType") == SUMMARY_PREDICATE:
            underway.summaries.append((envelope, statement))
            return
        for rule in underway.policy.suites:
            counts = not suite_problems(underway.artefact, underway.policy.digest, rule, statement)
            if counts and rule.name not in underway.kept:
                underway.kept[rule.name] = (envelope, statement)

    # -- runs -----------------------------------------------------------------------------------------------------

    def ask(self, underway: ChartInProgress) -> Sequence[SuiteResult]:
        """Ask the runner for every missing suite that runs already or needs no test namespace; the results that came
        now. UnavailableError when the runner does not answer: time does not count then."""
        return self._ask_all(underway, underway.awaited(starting=False))

    def start(self, underway: ChartInProgress) -> Sequence[SuiteResult]:
        """Ask the runner for suites that hold a test namespace for the first time; else as `ask`."""
        return self._ask_all(underway, underway.startable())

    def _ask_all(self, underway: ChartInProgress, rules: Sequence[SuiteRule]) -> Sequence[SuiteResult]:
        came = []
        try:
            for rule in rules:
                result = self._ask(underway, rule)
                if result is not None:
                    underway.results[rule.name] = result
                    underway.ended[rule.name] = self._now()
                    came.append(result)
        except Exception:
            underway.since.clear()
            raise
        return came

    def _ask(self, underway: ChartInProgress, rule: SuiteRule) -> SuiteResult | None:
        repository = f"{self._settings.staging}/{underway.chart.chart}"
        request = SuiteRequest(
            underway.artefact,
            repository,
            underway.policy.digest,
            rule,
            underway.chart.document,
            underway.replaced,
            underway.attempt,
        )
        try:
            progress = self._runner.run(request)
        except InputError as error:
            return _unfinished(rule, "the suite-runner accepts the request", str(error))
        underway.reasons[rule.name] = progress.reason
        if progress.result is not None:
            return _checked(rule, progress.result)
        if underway.states.get(rule.name) != progress.status or rule.name not in underway.since:
            underway.states[rule.name] = progress.status
            underway.since[rule.name] = self._monotonic()
        allowed = rule.seconds + MARGIN_SECONDS if progress.status == "running" else QUEUE_SECONDS_MAX
        if self._monotonic() - underway.since[rule.name] > allowed:
            return _unfinished(rule, "ends within its time", f"still {progress.status} after {allowed:.0f} s")
        return None

    # -- signing, attaching, copying ------------------------------------------------------------------------------

    def attach_results(self, underway: ChartInProgress) -> Mapping[str, str]:
        """Sign every result, attach the statements to the chart in staging; suite -> digest of the attachment."""
        for name, result in underway.results.items():
            if name not in underway.signed:
                statement = suite_statement(underway.artefact, underway.policy.digest, result)
                underway.signed[name] = self._signer.sign(statement)
        return {name: self._attach(underway, name, data) for name, data in self._envelopes(underway).items()}

    def publish(self, underway: ChartInProgress) -> VerifiedChart:
        """Sign, attach, copy the chart and its evidence to `verified`; its entry in the catalogue.

        InputError when what was signed does not suffice, so that it can never be published."""
        attached = dict(self.attach_results(underway))
        envelopes = self._envelopes(underway)
        envelopes[SUMMARY] = self._summary(underway, envelopes)
        attached[SUMMARY] = self._attach(underway, SUMMARY, envelopes[SUMMARY])
        chart = underway.chart
        source, target = (f"{where}/{chart.chart}" for where in (self._settings.staging, self._settings.verified))
        self._oci_registry.copy_chart(source, target, chart.digest, chart.tag, list(attached.values()))
        underway.evidence = sha256(envelopes[SUMMARY])
        return VerifiedChart(chart, envelopes, underway.evidence, underway.policy.digest, underway.schema)

    def _envelopes(self, underway: ChartInProgress) -> dict[str, bytes]:
        return {**{name: kept[0] for name, kept in underway.kept.items()}, **underway.signed}

    def _summary(self, underway: ChartInProgress, envelopes: Mapping[str, bytes]) -> bytes:
        """The kept summary of exactly these envelopes, or a new one."""
        statements = {name: self._verifier.verify(data) for name, data in envelopes.items()}
        for envelope, statement in underway.summaries:
            if self._suffices(underway, statements, statement) == "":
                return envelope
        digests = {name: statement.envelope_digest for name, statement in statements.items()}
        where = f"{self._settings.charts_url}/{underway.chart.chart}"
        document = summary_statement(
            underway.artefact,
            underway.policy,
            f"{self._settings.policy_uri}/{PATH}",
            where,
            self._settings.verifier,
            self._now(),
            digests,
            underway.listing,
        )
        envelope = self._signer.sign(document)
        verified = self._verifier.verify(envelope)
        problem = self._suffices(underway, statements, verified)
        if problem:
            raise InputError(f"{underway.chart.name}: what was signed here does not suffice: {problem}")
        underway.summaries.append((envelope, verified))
        return envelope

    @staticmethod
    def _suffices(
        underway: ChartInProgress, statements: Mapping[str, VerifiedStatement], summary: VerifiedStatement
    ) -> str:
        all_statements = {**statements, SUMMARY: summary}
        return assess(
            underway.artefact, underway.policy, summary.envelope_digest, all_statements, underway.listing
        ).explanation

    def _attach(self, underway: ChartInProgress, name: str, envelope: bytes) -> str:
        chart = underway.chart
        repository = f"{self._settings.staging}/{chart.chart}"
        return self._oci_registry.attach(
            repository, chart.digest, ENVELOPE_MEDIA_TYPE, envelope, attachment_annotations(name)
        )


def _checked(rule: SuiteRule, result: SuiteResult) -> SuiteResult:
    """The result if it is one of this suite that says something; else an unfinished one. A passed one with a failed
    check has failed."""
    if (result.suite, result.version) != (rule.name, rule.version):
        return _unfinished(rule, "is the suite that was asked for", f"{result.suite} {result.version} answered")
    if result.outcome == "passed" and not result.checks:
        return _unfinished(rule, "checks something", "it passed without a single check")
    if result.outcome == "passed" and result.failed:
        return replace(result, outcome="failed")
    return result


def _unfinished(rule: SuiteRule, check: str, problem: str) -> SuiteResult:
    fix = "submit again; if it stays so, ask who runs the platform (log of the suite-runner)"
    return SuiteResult(rule.name, rule.version, "unfinished", (Check(check, False, problem, fix),), 0.0)
