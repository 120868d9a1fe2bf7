"""The observer of merged plans: it compares them with the cluster, and asks Argo CD again until they are shown."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence

from robotkube.delivery.deployment.core.releases import RELEASES, Release, application_name
from robotkube.delivery.manager.core.observation import ReleaseVerdict, judge_present, judge_removed
from robotkube.delivery.manager.loops.proposals.plan_records import PlanRecord
from robotkube.delivery.manager.ports.argocd import ArgoCD
from robotkube.delivery.manager.ports.cluster import Cluster

ASK_SECONDS = 2.0
EAGER_SECONDS_MAX = 60.0
ASK_SECONDS_LATER = 15.0
OBSERVE_SECONDS_MAX = 900.0
REFRESHES_MAX = 3
PLANS_MAX = 200

log = logging.getLogger(__name__)


class PlanObserver:
    """The observer. `in_background` runs a call without holding up the caller, or drops it while one is running."""

    def __init__(
        self,
        cluster: Cluster,
        argocd: ArgoCD,
        in_background: Callable[[Callable[[], None]], None],
        now_ns: Callable[[], int],
        monotonic: Callable[[], float],
    ) -> None:
        self._cluster = cluster
        self._argocd = argocd
        self._in_background = in_background
        self._now_ns = now_ns
        self._monotonic = monotonic
        self._watched: dict[str, tuple[PlanRecord, float]] = {}
        self._open: dict[str, PlanRecord] = {}
        self._given_up: list[PlanRecord] = []
        self._asked_at = 0.0
        self._turn = 0

    @property
    def waiting(self) -> bool:
        """Return whether a merged plan is not observed yet."""
        return bool(self._watched)

    def watch(self, record: PlanRecord) -> None:
        """Follow a plan whose commit is on main; the oldest is given up when there are too many."""
        self._watched[record.id] = (record, self._monotonic())
        self._asked_at = self._monotonic()
        while len(self._watched) > PLANS_MAX:
            oldest = self._watched.pop(next(iter(self._watched)))[0]
            self._give_up(oldest, f"not observed: more than {PLANS_MAX} plans were waiting")

    def given_up(self) -> list[PlanRecord]:
        """The plans that are given up although they were not observed; each is returned once."""
        records, self._given_up = self._given_up, []
        return records

    def forget_observed(self, present: Mapping[str, Release]) -> None:
        """Drop plans that are observed already: after a restart nobody knows when that was."""
        for record, _ in list(self._watched.values()):
            verdicts = self._verdicts(record, present)
            if all(verdict.done for verdict in verdicts.values()):
                self._watched.pop(record.id)
                self._leave_open(record, verdicts)

    def _leave_open(self, record: PlanRecord, verdicts: Mapping[str, ReleaseVerdict]) -> None:
        """Close a plan that is observed, unless old pods on dead nodes are out of reach."""
        record.unreachable = tuple(pod for verdict in verdicts.values() for pod in verdict.unreachable)
        self._open.pop(record.id, None)
        if record.unreachable:
            self._open[record.id] = record
        while len(self._open) > PLANS_MAX:
            self._open.pop(next(iter(self._open)))

    def observe(self, present: Mapping[str, Release], tip: str) -> list[PlanRecord]:
        """Compare every watched plan with the cluster; return those now observed. `present` are main's releases."""
        applications = self._cluster.applications()
        for record in list(self._open.values()):
            self._leave_open(record, self._verdicts(record, present))
        done: list[PlanRecord] = []
        unheard: list[str] = []
        stuck: list[str] = []
        base = tip
        for record, since in list(self._watched.values()):
            verdicts = self._verdicts(record, present)
            if all(verdict.synced for verdict in verdicts.values()):
                record.times.setdefault("synced", self._now_ns())
            if all(verdict.done for verdict in verdicts.values()):
                record.times.setdefault("observed", self._now_ns())
                record.error = "; ".join(v.message for v in verdicts.values() if v.message) or None
                done.append(record)
                self._watched.pop(record.id)
                self._leave_open(record, verdicts)
            elif self._monotonic() - since > OBSERVE_SECONDS_MAX:
                self._watched.pop(record.id)
                left = "; ".join(f"{key}: {v.message}" for key, v in verdicts.items() if not v.done)
                self._give_up(record, f"not observed within {OBSERVE_SECONDS_MAX:.0f} s: {left}")
            else:
                missing = [application_name(*key.split("/")) for key, v in verdicts.items() if not v.annotated]
                unheard += missing
                stuck += [application_name(*key.split("/")) for key, v in verdicts.items() if v.stuck]
                base = record.base if missing and base == tip else base
        if (unheard or stuck) and self._due():
            self._ask(base, tip, unheard, stuck, list(applications))
        return done

    def _verdicts(self, record: PlanRecord, present: Mapping[str, Release]) -> dict[str, ReleaseVerdict]:
        """The verdicts about the releases that this plan was the last to write or remove; a later plan answers for the
        others."""
        applications = self._cluster.applications()
        verdicts: dict[str, ReleaseVerdict] = {}
        for key in (*record.created, *record.changed):
            release = present.get(f"{RELEASES}/{key}.yaml")
            if release is not None and release.plan == record.id:
                verdicts[key] = judge_present(applications.get(application_name(*key.split("/"))), record.id)
        for key in record.removed:
            if f"{RELEASES}/{key}.yaml" not in present:
                verdicts[key] = judge_removed(
                    applications.get(application_name(*key.split("/"))), self._cluster.pods(key)
                )
        return verdicts

    def _give_up(self, record: PlanRecord, why: str) -> None:
        record.error = why
        record.times["given_up"] = self._now_ns()
        self._given_up.append(record)
        log.error("plan not observed plan=%s reason=%s", record.id, why)

    def _due(self) -> bool:
        oldest = min(since for _, since in self._watched.values())
        pause = ASK_SECONDS if self._monotonic() - oldest < EAGER_SECONDS_MAX else ASK_SECONDS_LATER
        if self._monotonic() - self._asked_at < pause:
            return False
        self._asked_at = self._monotonic()
        return True

    def _ask(self, before: str, after: str, unheard: Sequence[str], stuck: Sequence[str], known: Sequence[str]) -> None:
        """Ask Argo CD again: by the hook and a refresh for Applications that do not know their plan (a waiting
        ApplicationSet is freed by the refresh of any Application it owns), by a refresh, in turns, for those that could
        not be compared."""
        existing = [name for name in (*unheard, *stuck) if name in known] or list(known[:1])
        turn = self._turn % len(existing) if existing else 0
        self._turn = turn + REFRESHES_MAX
        chosen = [*existing[turn:], *existing[:turn]][:REFRESHES_MAX]
        log.info("asking again applications=%d stuck=%d after=%s", len(unheard), len(stuck), after[:12])

        def ask() -> None:
            if unheard:
                self._argocd.hook(before, after)
            for name in chosen:
                self._argocd.refresh(name)

        self._in_background(ask)
