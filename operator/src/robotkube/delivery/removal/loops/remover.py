"""The remover: it reads what the Inspections name, takes away what the policy lets it, and says what became of it."""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable, Sequence

from robotkube.backoffs import Random, backoff
from robotkube.delivery.removal.core.conditions import REMOVED, Outcome, condition_of
from robotkube.delivery.removal.core.named import NamedStrangers, read_inspection
from robotkube.delivery.removal.core.targets import (
    Left,
    PodTarget,
    RemovalPolicy,
    Target,
    WorkloadTarget,
    merged,
    target_of,
)
from robotkube.delivery.removal.loops.removing import NamedIn, Removing
from robotkube.delivery.removal.loops.returns import Returns
from robotkube.delivery.removal.ports import RemovalCluster
from robotkube.errors import RobotKubeError
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.runtime.ports import Series, by_one

POLL_SECONDS = 3.0
PAUSE_SECONDS_MAX = 30.0
SILENCE_SECONDS_MAX = 60.0

log = logging.getLogger(__name__)

Answers = dict[Target, Outcome]


class Remover:
    """Turn after turn until it is stopped; `clock` counts seconds and never goes back, `now_ns` is the wall clock."""

    def __init__(
        self,
        cluster: RemovalCluster,
        policy: RemovalPolicy,
        clock: Callable[[], float],
        now_ns: Callable[[], int],
        random: Random,
    ) -> None:
        self._cluster = cluster
        self._policy = policy
        self._clock = clock
        self._now_ns = now_ns
        self._random = random
        self._removing = Removing(cluster, Returns(random, policy.per_minute), clock)
        self._lock = threading.Lock()
        self._conditions: dict[str, str] = {}
        self._failures = 0
        self._turned: float | None = None

    def run(self, stopping: threading.Event) -> None:
        """Turns until `stopping` is set."""
        failed = 0
        while not stopping.is_set():
            try:
                self.turn()
                failed = 0
            except RobotKubeError as error:
                failed += 1
                self._failures += 1
                log.warning("turn failed reason=%s", error)
            pause = backoff(failed - 1, POLL_SECONDS, PAUSE_SECONDS_MAX, self._random) if failed else 0.0
            stopping.wait(POLL_SECONDS + pause)

    def turn(self) -> None:
        """Read all Inspections, and act on them. UnavailableError when the API server does not answer."""
        documents = self._cluster.inspections()
        inspections = [read_inspection(document, REMOVED) for document in documents]
        now = self._now_ns()
        believed = [inspection for inspection in inspections if inspection.is_believed(now)]
        answers = self._act(believed)
        for one in inspections:
            self._say(one, self._outcomes(one, answers) if one in believed else [], one in believed)
        with self._lock:
            self._turned = self._clock()
            self._conditions = {
                inspection.name: self._conditions.get(inspection.name, "") for inspection in inspections
            }

    def reasons_not_ready(self) -> list[str]:
        """Empty while it reads the Inspections."""
        turned = self._turned
        if turned is None:
            return ["the Inspections were not read yet"]
        silent = self._clock() - turned
        return [f"the Inspections were read last {silent:.0f} s ago"] if silent > SILENCE_SECONDS_MAX else []

    def metrics(self) -> Sequence[Series]:
        """What was done, and how it stands; for any thread."""
        with self._lock:
            states = Counter(reason for reason in self._conditions.values() if reason)
            failures = float(self._failures)
        results = {key: float(count) for key, count in dict(self._removing.results).items()}
        return (
            Series("robotkube_removals_total", "counter", "What was tried.", results, ("act", "result")),
            Series(
                "robotkube_removal_inspections",
                "gauge",
                "Inspections by what became of what they name.",
                by_one({reason: float(count) for reason, count in states.items()}),
                ("reason",),
            ),
            Series(
                "robotkube_removal_coming_again",
                "gauge",
                "Makers that made something again after it was taken away.",
                {(): float(self._removing.coming_again())},
            ),
            Series("robotkube_removal_turn_failures_total", "counter", "Turns that ended early.", {(): failures}),
        )

    def _targets(self, one: NamedStrangers) -> list[Target]:
        return [target_of(stranger, one.looks_at, self._policy) for stranger in one.strangers]

    def _act(self, inspections: Sequence[NamedStrangers]) -> Answers:
        """Take away what these name: workloads first, each target once."""
        places: dict[Target, NamedIn] = {}
        for inspection in inspections:
            for target in self._targets(inspection):
                places.setdefault(target, NamedIn(inspection.name, inspection.uid))
        parts = [target for target in places if isinstance(target, WorkloadTarget)]
        whole = merged(parts)
        self._removing.begin(whole)
        answers: Answers = {}
        for workload in whole:
            own = [part for part in parts if _same(part, workload)]
            answers |= dict.fromkeys(own, self._removing.restore(workload, places[own[0]]))
        pods = sorted(target for target in places if isinstance(target, PodTarget))
        done: dict[str, Outcome] = {}  # a pod may be named twice: as foreign, and for a container of it
        for pod in pods:
            if pod.uid not in done:
                done[pod.uid] = self._removing.delete(pod, places[pod])
            answers[pod] = done[pod.uid]
        return answers

    def _outcomes(self, one: NamedStrangers, answers: Answers) -> list[Outcome]:
        targets = self._targets(one)
        return [
            Outcome(target.reason, target.sentence) if isinstance(target, Left) else answers[target]
            for target in targets
        ]

    def _say(self, one: NamedStrangers, outcomes: Sequence[Outcome], believed: bool) -> None:
        """Write the condition when it says something new, with an Event when a person has to do something."""
        condition = condition_of(outcomes, believed)
        with self._lock:
            self._conditions[one.name] = condition.reason
        if condition.is_said(one.condition):
            return
        self._cluster.write_condition(one.name, condition.document(one.condition, time_text(self._now_ns())))
        if condition.warns:
            self._cluster.report(one.name, one.uid, condition.reason, condition.message, True)


def _same(part: WorkloadTarget, whole: WorkloadTarget) -> bool:
    return (part.namespace, part.name, part.uid, part.generation) == (
        whole.namespace,
        whole.name,
        whole.uid,
        whole.generation,
    )
