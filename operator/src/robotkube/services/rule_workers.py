"""Rules in processes of their own: who is asked, what is dropped, who is suspended and when it is tried again.

A rule that fails, overruns its budget or does not answer is suspended by name and started anew after a pause that
doubles; the others go on. Nothing here blocks, but `settle` and, in a replay, `ask`: there no question may be lost.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.domain.rules import Cel, Python, Question, Rule, Verdict
from robotkube.ports.rules import RuleProcess

QUESTIONS_MAX = 1000
QUESTION_BYTES_MAX = 32 * 1024 * 1024
START_SECONDS_MAX = 30.0
STUCK_SECONDS_MIN, STUCK_BUDGETS = 5.0, 20.0
RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 1.0, 60.0
WELL_SECONDS = 60.0
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
    waiting: deque[Question] = field(default_factory=deque)
    bytes: int = 0
    moved_at: float = 0.0
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
        """In one word."""
        process = self.process  # other threads look, too
        if process is None:
            return SUSPENDED
        return RUNNING if process.ready else STARTING

    @property
    def stuck_seconds(self) -> float:
        """How long no reply may come while questions wait."""
        return max(STUCK_SECONDS_MIN, STUCK_BUDGETS * self.budget_seconds)


class RuleWorkers:
    """The processes of all rules of kinds cel and python. `start` makes a rule's process; it must not block.

    `lossless`: as a replay needs it; who asks waits rather than that a question is dropped.
    """

    def __init__(
        self, start: Callable[[Rule], RuleProcess], monotonic: Callable[[], float], lossless: bool = False
    ) -> None:
        self._start, self._monotonic, self._lossless = start, monotonic, lossless
        self._workers: dict[str, _Worker] = {}
        self._verdicts: list[Verdict] = []

    def apply(self, rules: Sequence[Rule]) -> None:
        """Take these rules; the processes of unchanged ones go on."""
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

    def ask(self, question: Question) -> None:
        """Hand a question to its rule's process; dropped and counted when too many wait or the rule is suspended."""
        worker = self._workers.get(question.rule)
        if worker is None:
            return
        worker.asked += 1
        size = QUESTION_BYTES + len(question.data)
        if self._lossless:
            self._make_room(worker, size)
        full = len(worker.waiting) >= QUESTIONS_MAX or worker.bytes + size > QUESTION_BYTES_MAX
        if worker.process is None or full:
            worker.dropped += 1
            return
        if not worker.waiting:
            worker.moved_at = self._monotonic()
        worker.waiting.append(question)
        worker.bytes += size
        worker.process.ask(question)

    def collect(self) -> list[Verdict]:
        """The verdicts that have come; rules that fail are suspended here, and those whose pause is over started."""
        now = self._monotonic()
        for worker in self._workers.values():
            self._look_after(worker, now)
        verdicts, self._verdicts = self._verdicts, []
        return verdicts

    def settle(self, seconds_max: float = SETTLE_SECONDS_MAX) -> list[Verdict]:
        """Wait until every question is answered, then the verdicts; those of suspended rules are left out."""
        end = self._monotonic() + seconds_max
        found = self.collect()
        for worker in self._workers.values():
            while worker.waiting and worker.process is not None and self._monotonic() < end:
                worker.process.wait(WAIT_SECONDS)
                self._look_after(worker, self._monotonic())
        return found + self.collect()

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

    def _make_room(self, worker: _Worker, size: int) -> None:
        end = self._monotonic() + SETTLE_SECONDS_MAX
        while worker.process is not None and self._monotonic() < end:
            if len(worker.waiting) < QUESTIONS_MAX and worker.bytes + size <= QUESTION_BYTES_MAX:
                return
            worker.process.wait(WAIT_SECONDS)
            self._look_after(worker, self._monotonic())

    def _look_after(self, worker: _Worker, now: float) -> None:
        if worker.process is None:
            if now >= worker.resume_at:
                self._begin(worker)
            return
        failure = worker.process.failure  # before the replies: what it said last comes before its end
        error = self._take_replies(worker, worker.process, now)
        problem = error or failure or self._stuck(worker, worker.process, now)
        if problem:
            self._suspend(worker, problem, now)
        elif worker.failures and worker.process.ready and now - worker.started_at > WELL_SECONDS:
            worker.failures, worker.problem = 0, ""

    def _take_replies(self, worker: _Worker, process: RuleProcess, now: float) -> str:
        """Pass on what was answered; the error of the first reply that is one."""
        for reply in process.replies():
            question = worker.waiting.popleft()
            worker.bytes -= QUESTION_BYTES + len(question.data)
            worker.moved_at = now
            if reply.error:
                worker.dropped += 1
                return reply.error
            worker.answered += 1
            if question.evaluate:
                self._verdicts.append(Verdict(question, reply.answers))
        return ""

    def _stuck(self, worker: _Worker, process: RuleProcess, now: float) -> str:
        if not process.ready:
            late = now - worker.started_at > START_SECONDS_MAX
            worker.moved_at = now
            return f"it has not started within {START_SECONDS_MAX:g} s" if late else ""
        if worker.waiting and now - worker.moved_at > worker.stuck_seconds:
            return f"it has not answered for {worker.stuck_seconds:g} s"
        return ""

    def _begin(self, worker: _Worker) -> None:
        worker.process = self._start(worker.rule)
        worker.started_at = worker.moved_at = self._monotonic()

    def _suspend(self, worker: _Worker, problem: str, now: float) -> None:
        self._end(worker)
        pause = min(RETRY_SECONDS_FIRST * 2**worker.failures, RETRY_SECONDS_MAX)
        worker.failures = min(worker.failures + 1, 10)
        worker.suspensions += 1
        worker.problem, worker.resume_at = problem, now + pause
        log.error("rule %s: suspended for %.0f s: %s", worker.rule.name, pause, problem)

    def _end(self, worker: _Worker) -> None:
        if worker.process is not None:
            worker.process.stop()
            worker.process = None
        worker.dropped += len(worker.waiting)
        worker.waiting.clear()
        worker.bytes = 0
