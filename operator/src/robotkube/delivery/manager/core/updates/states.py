"""States of releases in updates, as people see them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.updates.cluster_health import ClusterHealth
from robotkube.delivery.manager.core.updates.memory import UpdateMemory
from robotkube.delivery.manager.core.updates.rollouts import Rollout
from robotkube.delivery.manager.core.updates.verdicts import Trial

TRIAL = "trial"
WAITING = "waiting"
KEPT_BACK = "kept_back"
UNMEASURED = "unmeasured"
STATES: Mapping[str, str] = {
    TRIAL: "has the new version, which has not succeeded there yet",
    WAITING: "has an older version than it may get",
    KEPT_BACK: "has an older version, since the new one failed on this agent alone",
    UNMEASURED: "has the new version, which counts as a success by its health, since nobody took a measure of it",
}


@dataclass(frozen=True)
class ReleaseUpdate:
    """The state of one release in an update (of STATES), and the reason in words."""

    state: str
    text: str


def states_of(
    rollout: Rollout, trial: Trial, cluster_health: ClusterHealth, fixed: frozenset[str], memory: UpdateMemory
) -> dict[str, ReleaseUpdate]:
    """The states of the rollout's releases by key; those that have succeeded, and were measured, have none."""
    states = {key: ReleaseUpdate(TRIAL, f"{rollout.name} {trial.reasons[key]}") for key in trial.unsettled}
    for key in trial.good:
        if unseen := trial.reasons.get(key):
            states[key] = ReleaseUpdate(UNMEASURED, f"{rollout.name} counts as a success by its health alone: {unseen}")
    for release in rollout.behind:
        states[release.key] = ReleaseUpdate(WAITING, _why(release, rollout, trial, cluster_health, fixed))
    for release in rollout.kept_back:
        states[release.key] = ReleaseUpdate(KEPT_BACK, memory.keeps_back(rollout.target.digest, release))
    return states


def _why(release: Release, rollout: Rollout, trial: Trial, cluster_health: ClusterHealth, fixed: frozenset[str]) -> str:
    """The reason why a release has an older version."""
    if release.key in fixed:
        return f"{rollout.name} does not suit it, as the manager's log says"
    if release.namespace not in cluster_health.online:
        return f"{rollout.name} waits: the agent is offline or holds changes"
    if rollout.on_trial(trial) and trial.begun:
        return f"{rollout.name} follows when it has succeeded for {', '.join(trial.unsettled)}"
    return f"{rollout.name} is next"
