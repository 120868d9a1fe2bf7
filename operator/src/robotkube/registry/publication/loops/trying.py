"""Trying charts before they are submitted: the suites of the policy that can be run here, by the suite-runner's own
code, and for each of the others why it cannot.

Nothing is pushed and nothing is signed: what passes here is verified again when it is submitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from typing import Literal, Protocol

from robotkube.registry.charts.core.packing import PackedChart, PulledChart
from robotkube.registry.charts.core.unpacking import unpack_chart
from robotkube.registry.charts.ports import ChartProgram
from robotkube.registry.evidence.core.statements import Outcome, SuiteResult
from robotkube.registry.evidence.core.verification_policy import PLAIN_SUITES, SuiteRule, VerificationPolicy
from robotkube.registry.publication.ports import ChartSource
from robotkube.registry.suites.core.requests import SuiteRequest
from robotkube.registry.suites.loops.run import NO_NAMESPACE, read_subject, run_suite
from robotkube.registry.suites.ports.suites import Subject, Suite

NOT_RUN: Literal["not run"] = "not run"
ON_THE_PLATFORM = "run by the platform's suite-runner when you submit"
LANES = 2  # most of the time is helm's, which is a process of its own


@dataclass(frozen=True)
class TriedSuite:
    """What became of one suite for one chart: its result, or `reason`, why it was not run."""

    chart: str
    version: str
    suite: str
    result: SuiteResult | None = None
    reason: str = ""

    @property
    def outcome(self) -> Outcome | Literal["not run"]:
        """The result in a word."""
        return self.result.outcome if self.result else NOT_RUN


@dataclass(frozen=True)
class _Packed:
    """The port PulledCharts on a chart that was just packed and is in no OCI registry."""

    chart: PackedChart

    def pull_chart(self, repository: str, digest: str) -> PulledChart:
        """The chart, unpacked as what comes from an OCI registry is."""
        return unpack_chart(f"{repository}@{digest}", self.chart.manifest, self.chart.config, self.chart.archive)


class ClusterRuns(Protocol):
    """Runs suites that need a test namespace."""

    def run(self, rule: SuiteRule, suite: Suite, subject: Callable[[str], Subject]) -> SuiteResult | str:
        """The result of a suite on the subject as it is rendered for a namespace; a text says why it was not run."""
        ...

    def stop(self) -> None:
        """Have what runs end soon."""
        ...


@dataclass(frozen=True)
class Trying:
    """What suites can be run with here: `suites` by name, `program` renders charts; `lacking` says of a suite why it
    cannot be run for any chart, `hindrance` why one that looks at images cannot be for this one (empty: it can);
    `cluster` runs those that need a test namespace, where there is one."""

    suites: Mapping[str, Suite]
    program: ChartProgram
    lacking: Mapping[str, str]
    hindrance: Callable[[ChartSource, str], str]
    clock: Callable[[], float]
    cluster: ClusterRuns | None = None

    def run(self, charts: Sequence[ChartSource], policy: VerificationPolicy) -> list[TriedSuite]:
        """Every suite of the policy for every chart, in this order; never raises for what a suite does. Suites that
        need a cluster begin when the others have passed."""
        pairs = list(product(charts, policy.suites))
        plain = self._all([pair for pair in pairs if pair[1].name in PLAIN_SUITES], policy, {})
        failed = {one.chart: one.suite for one in plain if one.outcome in ("failed", "unfinished")}
        others = self._all([pair for pair in pairs if pair[1].name not in PLAIN_SUITES], policy, failed)
        order = {(chart.packed.name, rule.name): number for number, (chart, rule) in enumerate(pairs)}
        return sorted([*plain, *others], key=lambda one: order[one.chart, one.suite])

    def _all(
        self,
        pairs: Sequence[tuple[ChartSource, SuiteRule]],
        policy: VerificationPolicy,
        failed: Mapping[str, str],
    ) -> list[TriedSuite]:
        lanes = ThreadPoolExecutor(LANES)
        try:
            return list(lanes.map(lambda pair: self._try(pair[0], pair[1], policy.digest, failed), pairs))
        except BaseException:  # an interruption among them: what runs on a cluster ends before it is removed there
            if self.cluster:
                self.cluster.stop()
            raise
        finally:
            lanes.shutdown(wait=True, cancel_futures=True)

    def _try(self, chart: ChartSource, rule: SuiteRule, policy_digest: str, failed: Mapping[str, str]) -> TriedSuite:
        packed = chart.packed
        result: SuiteResult | str = self._reason(chart, rule, failed) or self._result(chart, rule, policy_digest)
        if isinstance(result, str):
            return TriedSuite(packed.name, packed.version, rule.name, reason=result)
        return TriedSuite(packed.name, packed.version, rule.name, result)

    def _reason(self, chart: ChartSource, rule: SuiteRule, failed: Mapping[str, str]) -> str:
        if rule.name in self.lacking:
            return self.lacking[rule.name]
        if rule.image or rule.name not in self.suites:
            return ON_THE_PLATFORM
        if chart.packed.name in failed:
            return f"{failed[chart.packed.name]} did not pass; it is run when that has"
        return self.hindrance(chart, rule.name)

    def _result(self, chart: ChartSource, rule: SuiteRule, policy_digest: str) -> SuiteResult | str:
        submitted = chart.submitted
        pulled = _Packed(chart.packed)
        request = SuiteRequest(submitted.artefact, f"here/{submitted.chart}", policy_digest, rule, submitted.document)
        suite = self.suites[rule.name]

        def subject(namespace: str) -> Subject:
            return read_subject(request, pulled, self.program, namespace)

        if suite.needs_namespace:
            return self.cluster.run(rule, suite, subject) if self.cluster else ON_THE_PLATFORM
        return run_suite(rule, suite, lambda: subject(NO_NAMESPACE), None, self.clock)
