"""Rollouts: releases of one chart under one rule of people's policy, and the version they should all have."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from robotkube.delivery.deployment.core.policies.updates import UpdatePolicy, UpdateRule
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.updates.cluster_health import HEALTHY, PROGRESSING, ClusterHealth
from robotkube.delivery.manager.core.updates.memory import UpdateMemory
from robotkube.delivery.manager.core.updates.targets import Targets
from robotkube.delivery.manager.core.updates.verdicts import SuccessTerms, Trial
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.versions import version_key


@dataclass(frozen=True)
class Rollout:
    """Releases of one chart under one rule, and the version they should all have; `kept_back` are behind, too, of
    agents for whom it was taken back."""

    chart: str
    target: ChartVersion
    rule: UpdateRule
    behind: tuple[Release, ...] = ()
    updated: tuple[Release, ...] = ()
    kept_back: tuple[Release, ...] = ()

    @property
    def terms(self) -> SuccessTerms:
        """The terms on which the version succeeds."""
        return SuccessTerms(self.rule, self.target.success)

    @property
    def name(self) -> str:
        """Chart and version."""
        return f"{self.chart} {self.target.version}"

    def on_trial(self, trial: Trial) -> bool:
        """Return whether one agent has to succeed before the others: the rule says so, and there are others."""
        agents = {release.namespace for release in (*self.behind, *self.updated)}
        return self.rule.canary and len(agents) > 1 and bool(self.behind) and not trial.succeeded(self.rule)

    def free(self, cluster_health: ClusterHealth, fixed: frozenset[str]) -> list[Release]:
        """The releases that can move now: their agents are online, and the version suits them."""
        return [r for r in self.behind if r.key not in fixed and r.namespace in cluster_health.online]

    def first(self, online: Iterable[Release], cluster_health: ClusterHealth) -> str:
        """The namespace whose releases go first: one that people named, in their order; then one where they are
        healthy; then the first by name."""
        order = {namespace: place for place, namespace in enumerate(self.rule.first)}

        def place(release: Release) -> tuple[int, bool, str]:
            named = order.get(release.namespace, len(order))
            return named, _state(release, cluster_health) != HEALTHY, release.key

        return min(online, key=place).namespace


def rollouts_of(
    present: Iterable[Release], targets: Targets, policy: UpdatePolicy, memory: UpdateMemory
) -> list[Rollout]:
    """The rollouts: every chart and rule under which a release is behind, or was moved by the chart's last update."""
    barred = frozenset(memory.barred)
    rollouts: dict[tuple[str, str, str], Rollout] = {}
    current = targets.highest
    moving = [r for r in present if r.chart in memory.runs or current.get(r.chart) != r.version]
    for release in sorted(moving, key=lambda release: release.key):
        applications = tuple(sorted({cause.application for cause in release.causes}))
        target = targets.newest(release.chart, applications, barred)
        run = memory.runs.get(release.chart)
        if target is None:
            continue
        differs = release.version != target.version
        behind = differs and version_key(release.version) < version_key(target.version)
        updated = run is not None and release.digest == run.digest == target.digest and release.key in run.before
        if behind or updated:
            name, rule = policy.rule(release)
            place = release.chart, name, target.version
            rollout = rollouts.get(place) or Rollout(release.chart, target, rule)
            if updated:
                rollouts[place] = replace(rollout, updated=(*rollout.updated, release))
            elif memory.keeps_back(target.digest, release):
                rollouts[place] = replace(rollout, kept_back=(*rollout.kept_back, release))
            else:
                rollouts[place] = replace(rollout, behind=(*rollout.behind, release))
    return [rollouts[place] for place in sorted(rollouts)]


def _state(release: Release, cluster_health: ClusterHealth) -> str:
    return cluster_health.health[release.key].state if release.key in cluster_health.health else PROGRESSING
