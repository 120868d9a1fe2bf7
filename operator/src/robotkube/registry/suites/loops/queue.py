"""The queue of the suite-runner: it gives requests, in order, a test namespace or none, and keeps their results.

A key is run once, whoever asks how often; results live in memory, so that after a restart the gate asks again. Test
namespaces are emptied before they are used for the first time and after every run; one that cannot be emptied is
not used.
"""

from __future__ import annotations

import logging
import random
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from robotkube.backoffs import Random, backoff
from robotkube.errors import UnavailableError
from robotkube.foundation.runtime.ports import Series, by_one
from robotkube.registry.evidence.core.statements import SuiteResult
from robotkube.registry.evidence.core.verification_policy import PLATFORM_SUITES, SuiteRule
from robotkube.registry.suites.core.requests import SuiteProgress, SuiteRequest
from robotkube.registry.suites.loops.run import unfinished
from robotkube.registry.suites.ports.suites import Executor, NamespaceCleaner

QUEUE_MAX = 64
FINISHED_MAX = 256
PLAIN_WORKERS = 1  # suites without a test namespace: they need the processor, of which there are few
EMPTY_SECONDS_MAX = 90.0
EMPTY_PAUSE_SECONDS_FIRST, EMPTY_PAUSE_SECONDS_MAX = 5.0, 10.0
IDLE_SECONDS = 1.0
STOP_SECONDS_MAX = 4.0
QUEUED, RUNNING, FINISHED = "queued", "running", "finished"

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Run:
    request: SuiteRequest
    needs_namespace: bool
    status: str = QUEUED
    result: SuiteResult | None = None


class SuiteQueue:
    """The service behind the protocol; `needs_namespace`: whether the suite of a rule runs something."""

    def __init__(
        self,
        executor: Executor,
        cleaners: Sequence[NamespaceCleaner],
        needs_namespace: Callable[[SuiteRule], bool],
        clock: Callable[[], float] = time.monotonic,
        jitter: Random = random.random,
    ) -> None:
        self._jitter = jitter
        self._executor = executor
        self._cleaners = cleaners
        self._needs_namespace = needs_namespace
        self._clock = clock
        self._runs: dict[str, _Run] = {}
        self._changed = threading.Condition()
        self._stopping = threading.Event()
        self._unready = {cleaner.name: "is being emptied" for cleaner in cleaners}
        self.outcomes: Counter[tuple[str, ...]] = Counter()
        self.seconds: dict[str, float] = {}
        self._threads = [
            *(threading.Thread(target=self._work_in, args=(cleaner,), daemon=True) for cleaner in cleaners),
            *(threading.Thread(target=self._work, args=("",), daemon=True) for _ in range(PLAIN_WORKERS)),
        ]

    def start(self) -> None:
        """Empty the test namespaces and begin to work."""
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End what runs, within STOP_SECONDS_MAX."""
        self._stopping.set()
        self._executor.stop()
        with self._changed:
            self._changed.notify_all()
        deadline = time.monotonic() + STOP_SECONDS_MAX
        for thread in self._threads:
            if thread.is_alive():
                thread.join(max(deadline - time.monotonic(), 0.0))

    def put(self, request: SuiteRequest) -> SuiteProgress:
        """Progress of the request's run, which is put into the queue unless it is known. UnavailableError when
        QUEUE_MAX wait already."""
        with self._changed:
            known = self._runs.get(request.key)
            if known is None or _again(known, request):
                self._enqueue(request)
            return self._progress(self._runs[request.key])

    def _enqueue(self, request: SuiteRequest) -> None:
        if self._waiting() >= QUEUE_MAX:
            raise UnavailableError(f"{QUEUE_MAX} runs wait already; ask again later")
        self._runs.pop(request.key, None)  # at the end again: order is that of asking
        self._runs[request.key] = _Run(request, self._needs_namespace(request.rule))
        self._changed.notify_all()

    def _waiting(self) -> int:
        return sum(run.status == QUEUED for run in self._runs.values())

    def _progress(self, run: _Run) -> SuiteProgress:
        return SuiteProgress(run.status, run.result, self._reason(run) if run.status == QUEUED else "")

    def _reason(self, run: _Run) -> str:
        if run.needs_namespace and not self._cleaners:
            return "there is no test namespace: the platform was installed without a pool for suites"
        not_ready = self._not_ready()
        if run.needs_namespace and len(not_ready) == len(self._cleaners):
            return "no test namespace is ready: " + "; ".join(not_ready)
        waiting = [other for other in self._runs.values() if other.status == QUEUED]
        return f"{waiting.index(run)} runs wait before it"

    def _not_ready(self) -> list[str]:
        return [f"{name} {reason}" for name, reason in sorted(self._unready.items()) if reason]

    def reasons_not_ready(self) -> list[str]:
        """Empty while it can take requests; a test namespace that is not ready does not matter to who asks."""
        return ["stopping"] if self._stopping.is_set() else []

    def metrics(self) -> Sequence[Series]:
        """Runs, their time, and test namespaces that are not ready."""
        with self._changed:
            counts = Counter(run.status for run in self._runs.values())
            runs = by_one({status: counts[status] for status in (QUEUED, RUNNING)})
            outcomes = dict(self.outcomes)
            seconds = by_one(self.seconds)
            not_ready = len(self._not_ready())
        return (
            Series("robotkube_suite_runs", "gauge", "Runs that wait or work.", runs, ("status",)),
            Series("robotkube_suite_runs_total", "counter", "Ended runs by outcome.", outcomes, ("suite", "outcome")),
            Series("robotkube_suite_seconds_total", "counter", "Time that runs took.", seconds, ("suite",)),
            Series(
                "robotkube_suite_namespaces_not_ready", "gauge", "Test namespaces that cannot be used.", {(): not_ready}
            ),
        )

    def _work_in(self, cleaner: NamespaceCleaner) -> None:
        failures = 0
        while not self._stopping.is_set():
            try:
                cleaner.empty(EMPTY_SECONDS_MAX)
            except Exception as error:  # whatever it is: the test namespace is not used before it was emptied
                log.warning("test namespace not emptied namespace=%s reason=%s", cleaner.name, error)
                self._unready[cleaner.name] = f"cannot be emptied: {error}"
                bounds = EMPTY_PAUSE_SECONDS_FIRST, EMPTY_PAUSE_SECONDS_MAX
                self._stopping.wait(backoff(failures, *bounds, self._jitter))
                failures += 1
                continue
            failures = 0
            self._unready[cleaner.name] = ""
            self._do_next(cleaner.name)
            self._unready[cleaner.name] = "is in use or being emptied"

    def _work(self, namespace: str) -> None:
        while not self._stopping.is_set():
            self._do_next(namespace)

    def _do_next(self, namespace: str) -> None:
        """Wait for a run that needs a test namespace as this worker has or has not, and do it."""
        run = None
        while run is None and not self._stopping.is_set():
            with self._changed:
                run = self._next(bool(namespace))
                if run is None:
                    self._changed.wait(IDLE_SECONDS)
        if run is not None:
            if namespace:
                self._unready[namespace] = "is in use or being emptied"
            self._finish(run, self._execute(run.request, namespace), namespace)

    def _next(self, in_namespace: bool) -> _Run | None:
        for key, run in self._runs.items():
            if run.status == QUEUED and run.needs_namespace == in_namespace:
                self._runs[key] = replace(run, status=RUNNING)
                return self._runs[key]
        return None

    def _execute(self, request: SuiteRequest, namespace: str) -> SuiteResult:
        started = self._clock()
        try:
            return self._executor.execute(request, namespace)
        except Exception as error:  # the executor's trouble is no pass either
            words = f"the run could not be done: {type(error).__name__}: {error}"
            return unfinished(request.rule, words, self._clock() - started)

    def _finish(self, run: _Run, result: SuiteResult, namespace: str) -> None:
        artefact = run.request.artefact
        label = result.suite if result.suite in PLATFORM_SUITES else "custom"
        log.info(
            "suite finished suite=%s chart=%s version=%s digest=%s outcome=%s failed=%d seconds=%.1f namespace=%s",
            result.suite, artefact.chart, artefact.version, artefact.digest, result.outcome, len(result.failed),
            result.seconds, namespace or "none",
        )  # fmt: skip
        with self._changed:
            self.outcomes[label, result.outcome] += 1
            self.seconds[label] = self.seconds.get(label, 0.0) + result.seconds
            self._runs[run.request.key] = replace(run, status=FINISHED, result=result)
            self._forget()

    def _forget(self) -> None:
        finished = [key for key, run in self._runs.items() if run.status == FINISHED]
        for key in finished[: max(len(finished) - FINISHED_MAX, 0)]:
            del self._runs[key]


def _again(known: _Run, request: SuiteRequest) -> bool:
    """Return whether a finished run is done again: it did not pass, and another submission asks."""
    failed = known.result is not None and known.result.outcome != "passed"
    return failed and known.request.attempt != request.attempt
