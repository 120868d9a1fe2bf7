"""Removing: one stranger after the other is taken away, each in its own pauses."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from robotkube.delivery.inspection.core.strangers import STATIC_POD
from robotkube.delivery.removal.core.conditions import (
    COMES_AGAIN,
    REFUSED,
    REMOVING,
    RESTORING,
    TOO_MANY,
    Outcome,
)
from robotkube.delivery.removal.core.makers import DEPLOYMENT, Maker, maker_of
from robotkube.delivery.removal.core.patches import restoring_patch
from robotkube.delivery.removal.core.targets import NOT_BY_API, PodTarget, WorkloadTarget
from robotkube.delivery.removal.loops.returns import PAUSE_SECONDS_MAX, Returns
from robotkube.delivery.removal.ports import RemovalCluster
from robotkube.errors import InputError

DELETE, RESTORE = "delete", "restore"
ROLL_OUT_SECONDS = 10.0  # a restored Deployment replaces its pods by itself
MIRROR = "kubernetes.io/config.mirror"
DONE, CHANGED = "done", "changed"
RESULTS = (DONE, CHANGED, REFUSED)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class NamedIn:
    """The place where a target is named: an Inspection, with its UID."""

    inspection: str
    uid: str


class Removing:
    """Takes targets away; `returns` knows what was taken away before, `clock` counts seconds and never goes back.

    One turn is `begin`, then all workloads, then all pods: a pod of a workload that is still to be restored would be
    made again as it was."""

    def __init__(self, cluster: RemovalCluster, returns: Returns, clock: Callable[[], float]) -> None:
        self._cluster = cluster
        self._returns = returns
        self._clock = clock
        self._now = clock()
        self._changed: set[Maker] = set()
        self._refused: dict[tuple[str, Maker], Outcome] = {}  # by act and maker, as long as the last attempt was
        self.results: Counter[tuple[str, ...]] = Counter()

    def begin(self, workloads: Iterable[WorkloadTarget]) -> None:
        """A turn begins, in which these workloads are not what their charts render."""
        self._now = self._clock()
        self._returns.forget(self._now)
        self._changed = {_maker(workload) for workload in workloads}

    def restore(self, target: WorkloadTarget, place: NamedIn) -> Outcome:
        """Take out of a Deployment what its chart does not render."""
        maker = _maker(target)
        waiting = self._waits(RESTORE, maker)
        if waiting is not None:
            return waiting
        try:
            deployment = self._cluster.deployment(target.namespace, target.name)
        except InputError as error:
            return _refused(str(maker), error)
        if deployment is None:
            return Outcome(RESTORING, f"{maker} is gone")
        patch = restoring_patch(deployment, target)
        if isinstance(patch, str):
            return Outcome(RESTORING, f"{maker}: {patch}; the next look says what has to go")
        if not patch:
            return Outcome(RESTORING, f"{maker} has nothing of it any more")
        words = ", ".join(str(one["path"]) for one in reversed(patch[1:]))
        act = _Act(RESTORE, "Restored", f"{maker} was restored: {words} taken away", maker, place)
        return self._done(act, lambda: self._cluster.patch_deployment(deployment, patch))

    def delete(self, target: PodTarget, place: NamedIn) -> Outcome:
        """Delete a pod."""
        name = f"Pod {target.namespace}/{target.name}"
        try:
            pod = self._cluster.pod(target.namespace, target.name)
        except InputError as error:
            return _refused(name, error)
        if pod is None or pod["metadata"].get("uid") != target.uid:
            return Outcome(REMOVING, f"{name} is gone")
        if pod["metadata"].get("deletionTimestamp"):
            return Outcome(REMOVING, f"{name} is ending")
        if MIRROR in (pod["metadata"].get("annotations") or {}):
            return Outcome(NOT_BY_API, f"{STATIC_POD} {name[4:]} stands on its machine: take its file away there")
        maker = maker_of(pod)
        waiting = self._waits_for_workload(name, maker) or self._waits(DELETE, maker)
        if waiting is not None:
            return waiting
        act = _Act(DELETE, "Removed", f"{name} was deleted: it is not what main says", maker, place)
        return self._done(act, lambda: self._cluster.delete_pod(pod, target.grace_seconds))

    def coming_again(self) -> int:
        """How many makers made something again."""
        return self._returns.coming_again()

    def _waits_for_workload(self, name: str, maker: Maker) -> Outcome | None:
        rolls_out = self._returns.since(RESTORE, maker, self._now) < ROLL_OUT_SECONDS
        if maker in self._changed or rolls_out:
            return Outcome(REMOVING, f"{name} goes when {maker} is restored")
        return None

    def _waits(self, act: str, maker: Maker) -> Outcome | None:
        """Why nothing is taken away now; None when it is."""
        if not self._returns.is_due(act, maker, self._now):
            return self._again(act, maker)
        if self._returns.is_full(self._now):
            return Outcome(
                TOO_MANY,
                f"{maker} waits: so much was removed in the last minute that something else must be wrong. Look at "
                "what is named, or raise remover.perMinute",
            )
        return None

    def _again(self, act: str, maker: Maker) -> Outcome:
        count = self._returns.count(act, maker)
        if (act, maker) in self._refused:
            return self._refused[act, maker]
        if count > 1:
            return Outcome(COMES_AGAIN, _coming_again(act, maker, count))
        if act == RESTORE:
            return Outcome(RESTORING, f"{maker} was restored a moment ago")
        return Outcome(REMOVING, f"the next pod of {maker} is removed after a pause")

    def _done(self, act: _Act, change: Callable[[], bool]) -> Outcome:
        """Do it, and say so."""
        refused = None
        try:
            result = DONE if change() else CHANGED
        except InputError as error:
            result = REFUSED
            refused = _refused(str(act.maker), error)
        self.results[act.act, result] += 1
        if result == CHANGED:
            return Outcome(REMOVING, f"{act.maker}: changed at this very moment; tried again")
        self._returns.note(act.act, act.maker, self._now)
        self._refused.pop((act.act, act.maker), None)
        if refused is not None:
            log.warning("removal refused maker=%r act=%s reason=%s", str(act.maker), act.act, refused.sentence)
            self._refused[act.act, act.maker] = refused
            return refused
        log.warning("stranger removed inspection=%s act=%s what=%r", act.place.inspection, act.act, act.sentence)
        self._cluster.report(act.place.inspection, act.place.uid, act.event, act.sentence, False)
        count = self._returns.count(act.act, act.maker)
        if count > 1:
            return Outcome(COMES_AGAIN, _coming_again(act.act, act.maker, count))
        return Outcome(RESTORING if act.act == RESTORE else REMOVING, act.sentence)


@dataclass(frozen=True)
class _Act:
    """Something that is done: what, the reason of its Event, the sentence, to whom, and where it was named."""

    act: str
    event: str
    sentence: str
    maker: Maker
    place: NamedIn


def _maker(target: WorkloadTarget) -> Maker:
    return Maker(target.namespace, DEPLOYMENT, target.name)


def _refused(name: str, error: InputError) -> Outcome:
    return Outcome(REFUSED, f"{name} was not touched: {error}")


def _coming_again(act: str, maker: Maker, count: int) -> str:
    times = f"was {'restored' if act == RESTORE else 'removed'} {count} times and comes again"
    return (
        f"{maker} {times}; the pauses between grow to {PAUSE_SECONDS_MAX / 60:.0f} min. Look for who makes it: "
        f"kubectl -n {maker.namespace} get {maker.kind.lower()} {maker.name} -o yaml --show-managed-fields"
    )
