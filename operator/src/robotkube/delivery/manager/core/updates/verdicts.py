"""Verdicts about releases that got a new version of their chart, from their health since."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from robotkube.delivery.deployment.core.policies.updates import UpdateRule
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.updates.cluster_health import (
    DEGRADED,
    HEALTHY,
    PROGRESSING,
    SECOND_NS,
    ClusterHealth,
)
from robotkube.delivery.manager.core.updates.measures import Answer, Judged, answers_of
from robotkube.delivery.manager.core.updates.memory import ChartUpdate
from robotkube.registry.catalogue.core.success.measures import SuccessMeasure

NOTICED_SECONDS_MAX = 60  # a failure is noticed within this time, whatever the bounds of the rule

RanBefore = Callable[[Release, str, int], bool]
"""Whether a release is known to have been healthy with its version before a time (ns since 1970); the text is the
commit that updated it."""


def nobody_knows(release: Release, commit: str, before_ns: int) -> bool:
    """RanBefore of who has seen nothing."""
    return False


@dataclass(frozen=True)
class Trial:
    """The updated releases of agents that are online, by verdict. `late` ones are bad, too, on agents that came back
    after the update had begun: they are judged for themselves, since others have tried the version. `reasons`: why by
    key, of those that have not succeeded; of good ones, which measures nobody took."""

    good: tuple[str, ...] = ()
    bad: tuple[str, ...] = ()
    pending: tuple[str, ...] = ()
    late: tuple[str, ...] = ()
    reasons: Mapping[str, str] = field(default_factory=dict)

    @property
    def unsettled(self) -> tuple[str, ...]:
        """The releases that have not succeeded."""
        return (*self.pending, *self.bad, *self.late)

    @property
    def begun(self) -> bool:
        """Return whether the new version is anywhere."""
        return bool(self.good or self.unsettled)

    def failed(self, rule: UpdateRule) -> bool:
        """Return whether fewer than the rule's share can still succeed."""
        count = len(self.good) + len(self.bad) + len(self.pending)
        return bool(self.bad) and (count - len(self.bad)) < rule.threshold * count

    def succeeded(self, rule: UpdateRule) -> bool:
        """Return whether the rule's share has succeeded."""
        count = len(self.good) + len(self.bad) + len(self.pending)
        return bool(self.good) and len(self.good) >= rule.threshold * count


def try_out(
    updated: Iterable[Release],
    run: ChartUpdate | None,
    cluster: ClusterHealth,
    terms: SuccessTerms,
    now_ns: int,
    ran_before: RanBefore = nobody_knows,
) -> Trial:
    """The verdicts about the releases that the update `run` moved; agents that are offline are left out."""
    if run is None or not run.before:
        return Trial()
    verdicts: dict[str, list[str]] = {"good": [], "bad": [], "pending": [], "late": []}
    reasons: dict[str, str] = {}
    begun_ns = min(run.at_ns[key] for key in run.before)
    for release in updated:
        online = cluster.online.get(release.namespace)
        if online is not None:
            verdict, reason = _Trying(release, run, online, cluster, terms, ran_before).verdict(now_ns)
            late = verdict == "bad" and online > begun_ns
            verdicts["late" if late else verdict].append(release.key)
            reasons |= {release.key: reason} if reason else {}
    good, bad, pending, late_ones = (tuple(verdicts[name]) for name in ("good", "bad", "pending", "late"))
    trial = Trial(good, bad, pending, late_ones, reasons)
    return trial if trial.good or trial.bad or trial.pending else Trial(bad=trial.late, reasons=reasons)


@dataclass(frozen=True)
class SuccessTerms:
    """The terms on which a version succeeds: the rule of people's policy, and the measure of its author."""

    rule: UpdateRule
    measure: SuccessMeasure | None = None


@dataclass(frozen=True)
class _Trying:
    """A release that `run` updated, on an agent that is online since `online_ns`."""

    release: Release
    run: ChartUpdate
    online_ns: int
    cluster: ClusterHealth
    terms: SuccessTerms
    ran_before: RanBefore

    def verdict(self, now_ns: int) -> tuple[str, str]:
        """The verdict: good, bad or pending, and the reason; of a good one, why a measure was not taken, or nothing.
        The release could run since its agent came back, or a later plan changed it again."""
        rule = self.terms.rule
        health = self.cluster.health.get(self.release.key)
        begin_ns = max(self.run.at_ns[self.release.key], self.online_ns, plan_ns(self.release.plan))
        state = health.state if health else PROGRESSING
        known = health.since_ns if health else None
        first_ns = health.first_ns if health else None
        healthy_ns = max(known if known is not None else begin_ns, begin_ns) if state == HEALTHY else None
        first_ns = healthy_ns if first_ns is None else max(first_ns, begin_ns)
        judged = Judged(self.release.key, self.release.namespace, begin_ns, healthy_ns, first_ns)
        answers = answers_of(self.terms.measure, judged, self.cluster, now_ns)
        fault = next((f for answer in answers for f in answer.faults if self._is_blamed(f.since_ns)), None)
        if fault is not None:
            return "bad", fault.text
        if healthy_ns is not None:
            return self._measured(healthy_ns, answers, now_ns)
        since = now_ns if known is None else known
        late = now_ns - begin_ns >= rule.failure_seconds * SECOND_NS
        newly_degraded = state == DEGRADED and since >= begin_ns
        if (late or newly_degraded) and self._is_blamed(since):
            return "bad", f"degraded, or not healthy within {rule.failure_seconds} s"
        return "pending", self._needs(answers)

    def _measured(self, healthy_ns: int, answers: Sequence[Answer], now_ns: int) -> tuple[str, str]:
        """The verdict about a release that is healthy since then and has no fault. Of what nobody measures, health
        alone counts, and that is said."""
        holds_ns = max(
            [healthy_ns + self.terms.rule.success_seconds * SECOND_NS, *(answer.ends_ns for answer in answers)]
        )
        if now_ns < holds_ns:
            return "pending", self._needs(answers)
        return "good", _unseen(answers)

    def _needs(self, answers: Sequence[Answer]) -> str:
        """What must hold for the release, in words."""
        terms = [f"healthy for {self.terms.rule.success_seconds} s", *(a.terms for a in answers if not a.unseen)]
        unseen = _unseen(answers)
        return f"must be {' and '.join(terms)}{f' ({unseen})' if unseen else ''}"

    def _is_blamed(self, since_ns: int) -> bool:
        """Return whether trouble since then is the update's doing: it began soon after the update, or soon after the
        agent came back, if the version had never run there."""
        key = self.release.key
        rule = self.terms.rule
        measured = self.terms.measure.seconds if self.terms.measure else 0
        window = (2 * rule.failure_seconds + rule.success_seconds + measured + NOTICED_SECONDS_MAX) * SECOND_NS
        if since_ns < self.run.at_ns[key] + window:
            return True
        came_back = self.run.at_ns[key] < self.online_ns
        soon = since_ns < self.online_ns + window
        return came_back and soon and not self.ran_before(self.release, self.run.made_by.get(key, ""), self.online_ns)


def _unseen(answers: Iterable[Answer]) -> str:
    return "; ".join(answer.unseen for answer in answers if answer.unseen)


def plan_ns(plan: str) -> int:
    """The time in a plan's id, in ns since 1970; 0 when it is none."""
    try:
        return int(datetime.strptime(plan[:15], "%Y%m%d-%H%M%S").replace(tzinfo=UTC).timestamp()) * SECOND_NS
    except ValueError:
        return 0
