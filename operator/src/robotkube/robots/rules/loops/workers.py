"""The supervision of rules in processes of their own: questions, replies, what is dropped, suspension and restart.

A rule that fails, overruns its budget or does not answer is suspended by name and started anew after a pause that
doubles; the others go on. Nothing here blocks, but `settle` and, in a replay, `ask`: there no question may be lost.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.robots.rules.core import AnsweredQuestion, Cel, Python, Rule, RuleQuestion
from robotkube.robots.rules.ports import RuleProcess

QUESTIONS_MAX = 1000
QUESTION_BYTES_MAX = 32 * 1024 * 1024
START_SECONDS_MAX = 30.0
STUCK_SECONDS_MIN = 5.0
STUCK_BUDGETS = 20.0
RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 1.0, 60.0
HEALTHY_SECONDS = 60.0
SETTLE_SECONDS_MAX = 60.0
WAIT_SECONDS = 0.2
QUESTION_BYTES = 200
STARTING, RUNNING, SUSPENDED = "starting", "running", "suspended"

log = logging.getLogger(__name__)


@dataclass
class _Worker:
    """A rule, its process while there is one, and the questions that wait for replies."""

    rule: Rule
    budget_seconds: float
    process: RuleProcess | None = None
    waiting: deque[RuleQuestion] = field(default_factory=deque)
    bytes: int = 0
    progress_at: float = 0.0
    started_at: float = 0.0
    resume_at: float = 0.0
    failures: int = 0
    problem: str = ""
    asked: int = 0
    answered: int = 0
    dropped: int = 0
    suspensions: int = 0

    @property
    def state(self) -> str:
        """The state in one word."""
        process = self.process  # other threads read it, too
        if process is None:
            return SUSPENDED
        return RUNNING if process.ready else STARTING

    @property
    def stuck_seconds(self) -> float:
        """The longest time without a reply while questions wait."""
        return max(STUCK_SECONDS_MIN, STUCK_BUDGETS * self.budget_seconds)


class RuleWorkers:
    """The processes of all rules of kinds cel and python. `start` makes a rule's process; it must not block.

    `lossless`: `ask` waits rather than that a question is dropped, as a replay needs it.
    """

    def __init__(
        self, start: Callable[[Rule], RuleProcess], monotonic: Callable[[], float], lossless: bool = False
    ) -> None:
        self._start = start
        self._monotonic = monotonic
        self._lossless = lossless
        self._workers: dict[str, _Worker] = {}
        self._answered: list[AnsweredQuestion] = []

    def apply(self, rules: Sequence[Rule]) -> None:
        """Apply these rules; the processes of unchanged ones go on."""
        wanted = {rule.name: rule for rule in rules if isinstance(rule.condition, (Cel, Python))}
        for name, worker in list(self._workers.items()):
            if wanted.get(name) != worker.rule:
                self._end(worker)
                del self._workers[name]
        for name, rule in wanted.items():
            if name not in self._workers:
                assert isinstance(rule.condition, (Cel, Python))
                self._workers[name] = _Worker(rule, rule.condition.budget_seconds)
                self._begin(self._workers[name])

    def ask(self, question: RuleQuestion) -> None:
        """Send a question to its rule's process; it is dropped and counted when too many wait or the rule is
        suspended."""
        worker = self._workers.get(question.rule)
        if worker is None:
            return
        worker.asked += 1
        size = QUESTION_BYTES + len(question.data)
        if self._lossless:
            self._wait_for_space(worker, size)
        full = len(worker.waiting) >= QUESTIONS_MAX or worker.bytes + size > QUESTION_BYTES_MAX
        if worker.process is None or full:
            worker.dropped += 1
            return
        if not worker.waiting:
            worker.progress_at = self._monotonic()
        worker.waiting.append(question)
        worker.bytes += size
        worker.process.ask(question)

    def collect(self) -> list[AnsweredQuestion]:
        """The questions answered since the last call. Failed rules are suspended here, and restarted after a pause."""
        now = self._monotonic()
        for worker in self._workers.values():
            self._supervise(worker, now)
        answered = self._answered
        self._answered = []
        return answered

    def settle(self, seconds_max: float = SETTLE_SECONDS_MAX) -> list[AnsweredQuestion]:
        """Wait until every question is answered; returns the answered ones, without those of suspended rules."""
        end = self._monotonic() + seconds_max
        answered = self.collect()
        for worker in self._workers.values():
            while worker.waiting and worker.process is not None and self._monotonic() < end:
                worker.process.wait(WAIT_SECONDS)
                self._supervise(worker, self._monotonic())
        return answered + self.collect()

    def document(self) -> dict[str, Any]:
        """Each rule's state and counters as JSON values, for `/status`."""
        now = self._monotonic()
        return {
            name: {
                "state": worker.state,
                "problem": worker.problem,
                "resumes_in_seconds": None if worker.process else round(max(0.0, worker.resume_at - now), 1),
                "asked": worker.asked,
                "answered": worker.answered,
                "dropped": worker.dropped,
                "waiting": len(worker.waiting),
                "suspensions": worker.suspensions,
            }
            for name, worker in list(self._workers.items())
        }

    def stop(self) -> None:
        """End all processes."""
        for worker in self._workers.values():
            self._end(worker)
        self._workers.clear()

    def _wait_for_space(self, worker: _Worker, size: int) -> None:
        end = self._monotonic() + SETTLE_SECONDS_MAX
        while worker.process is not None and self._monotonic() < end:
            if len(worker.waiting) < QUESTIONS_MAX and worker.bytes + size <= QUESTION_BYTES_MAX:
                return
            worker.process.wait(WAIT_SECONDS)
            self._supervise(worker, self._monotonic())

    def _supervise(self, worker: _Worker, now: float) -> None:
        if worker.process is None:
            if now >= worker.resume_at:
                self._begin(worker)
            return
        failure = worker.process.failure  # before the replies: what it said last comes before its end
        error = self._receive_replies(worker, worker.process, now)
        problem = error or failure or self._stuck(worker, worker.process, now)
        if problem:
            self._suspend(worker, problem, now)
        elif worker.failures and worker.process.ready and now - worker.started_at > HEALTHY_SECONDS:
            worker.failures = 0
            worker.problem = ""

    def _receive_replies(self, worker: _Worker, process: RuleProcess, now: float) -> str:
        """Collect the replies; returns the error of the first one that has one, else an empty text."""
        for reply in process.replies():
            question = worker.waiting.popleft()
            worker.bytes -= QUESTION_BYTES + len(question.data)
            worker.progress_at = now
            if reply.error:
                worker.dropped += 1
                return reply.error
            worker.answered += 1
            if question.evaluate:
                self._answered.append(AnsweredQuestion(question, reply.answers))
        return ""

    def _stuck(self, worker: _Worker, process: RuleProcess, now: float) -> str:
        if not process.ready:
            late = now - worker.started_at > START_SECONDS_MAX
            worker.progress_at = now
            return f"it has not started within {START_SECONDS_MAX:g} s" if late else ""
        if worker.waiting and now - worker.progress_at > worker.stuck_seconds:
            return f"it has not answered for {worker.stuck_seconds:g} s"
        return ""

    def _begin(self, worker: _Worker) -> None:
        worker.process = self._start(worker.rule)
        worker.started_at = worker.progress_at = self._monotonic()

    def _suspend(self, worker: _Worker, problem: str, now: float) -> None:
        self._end(worker)
        pause = min(RETRY_SECONDS_FIRST * 2**worker.failures, RETRY_SECONDS_MAX)
        worker.failures = min(worker.failures + 1, 10)
        worker.suspensions += 1
        worker.problem = problem
        worker.resume_at = now + pause
        log.error("rule %s: suspended for %.0f s: %s", worker.rule.name, pause, problem)

    def _end(self, worker: _Worker) -> None:
        if worker.process is not None:
            worker.process.stop()
            worker.process = None
        worker.dropped += len(worker.waiting)
        worker.waiting.clear()
        worker.bytes = 0
