"""The operator reaction: a TaskDescription while an event lasts. The API server never holds reception up.

One thread works through a bounded queue. At first it lists the detector's own tasks: their events are taken over
(`adopted`), so that a detector that was restarted withdraws what its predecessor asked for. An event that was
dispatched anew before that list was read (the API server was away) goes on with the task that is there for its rule
and agents. A task of another chain, which another task launched this detector for, is withdrawn. A withdrawal that was
given up (the API server was away for too long, too much waited) stays pending: its lease is not renewed, and it is
tried again. The leases of its tasks are renewed by the same thread every third of their time, also while a call is
tried again.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import random
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robotkube.backoffs import Random, backoff
from robotkube.errors import RefusalError, RobotKubeError, UnavailableError
from robotkube.robots.reactions.core.notifications import delivery_id
from robotkube.robots.reactions.core.settings import OperatorReactionSettings
from robotkube.robots.reactions.core.task_requests import event_of, event_task, lease_seconds, parent_of
from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
from robotkube.robots.rules.core import START, Edge, task_name
from robotkube.robots.rules.core.event_documents import edge_document

if TYPE_CHECKING:
    from robotkube.robots.reactions.ports.tasks import OwnTasks

QUEUE_MAX, WITHDRAWALS_MAX = 256, 1000
RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 0.2, 5.0
TRY_SECONDS_MAX = 3600.0
WAIT_SECONDS, DRAIN_SECONDS = 0.5, 0.02
PROBE_SECONDS = 10.0
"""An API server to which no call was made for so long is asked for the tasks."""
NAME = "operator"
RENEWED_SHARE = 1 / 3  # of a lease

log = logging.getLogger(__name__)


@dataclass
class EventRecord:
    """One edge and its outcome: the task (`<namespace>/<name>`), when the API server acknowledged, or the error."""

    edge: Edge
    task: str | None = None
    done: int | None = None
    error: str | None = None

    def document(self) -> dict[str, Any]:
        """The record as /events shows it (docs/reference/contracts.md)."""
        return {**edge_document(self.edge), "task": self.task, "done": self.done, "error": self.error}


@dataclass(frozen=True)
class _Order:
    record: EventRecord
    reaction: OperatorReactionSettings | None
    reason: str
    parent: str


@dataclass
class _Lease:
    """A task whose lease is renewed; `due` in monotonic seconds."""

    seconds: int
    due: float


class OperatorReactions:
    """The tasks of one detector (`requester`: `<namespace>/<release>`): created, deleted, and their leases renewed.

    `parent`: the task that launched the detector; it may be set anew."""

    def __init__(
        self,
        requester: str,
        namespace: str,
        tasks: OwnTasks,
        clock_ns: Callable[[], int],
        monotonic: Callable[[], float],
        parent: str = "",
        box: DeadLetterBox | None = None,
        jitter: Random = random.random,
    ) -> None:
        self._jitter = jitter
        self._requester = requester
        self._namespace = namespace
        self._tasks = tasks
        self.parent = parent
        self._clock_ns = clock_ns
        self._monotonic = monotonic
        self._box = box or DeadLetterBox(clock_ns)
        self._delivered = self._retries = self._dead = 0
        self._adopted_tasks: dict[tuple[str, tuple[str, ...]], str] = {}
        self._orders: queue.Queue[_Order | None] = queue.Queue(QUEUE_MAX)  # None: check whether the end has come
        self._stopping = threading.Event()
        self._names: dict[str, str] = {}
        self._withdrawn: set[str] = set()
        self._pending_withdrawals: dict[str, Edge] = {}
        self._leases: dict[str, _Lease] = {}
        self._adopted_parent = parent
        self.adopted: list[Edge] | None = None
        self.reachable = False
        self._asked_at = monotonic()
        self._thread = threading.Thread(target=self._run, name="operator-reactions", daemon=True)

    def start(self) -> None:
        """Start the thread, which takes over the tasks of a predecessor first."""
        self._thread.start()

    def stop(self, seconds: float) -> None:
        """Carry out what waits, then end the thread, within `seconds`; the tasks of events that last stay."""
        end = self._monotonic() + seconds
        while self._orders.unfinished_tasks and self.reachable and self._monotonic() < end:
            self._stopping.wait(DRAIN_SECONDS)
        self._stopping.set()
        with contextlib.suppress(queue.Full):
            self._orders.put_nowait(None)
            self._orders.task_done()
        self._thread.join(max(0.0, end - self._monotonic()))

    def counts(self) -> Mapping[str, int]:
        """The counters: `delivered`, `retries`, `dead` only grow; `waiting`: edges that are not carried out yet."""
        waiting = self._orders.unfinished_tasks
        return {"delivered": self._delivered, "retries": self._retries, "dead": self._dead, "waiting": waiting}

    def react(self, record: EventRecord, reaction: OperatorReactionSettings | None, reason: str) -> None:
        """Queue an edge, whose task is made or withdrawn; never blocks. `reaction` may be None for a stop edge."""
        if record.edge.edge != START:
            self._withdrawn.add(record.edge.id)
        try:
            self._orders.put_nowait(_Order(record, reaction, reason, self.parent))
        except queue.Full:
            self._give_up(record, f"{QUEUE_MAX} reactions wait for the API server; this one was dropped")
            self._retry_withdrawal(record.edge)

    def _run(self) -> None:
        self._adopt()
        while not self._stopping.is_set():
            with contextlib.suppress(queue.Empty):
                if order := self._orders.get(timeout=WAIT_SECONDS):
                    self._carry_out(order)
                    self._orders.task_done()
            self._renew_leases()
            self._probe()
            self._withdraw_pending()

    def _probe(self) -> None:
        """Call the API server when it was not called for a while: it may be gone, or back."""
        if self._monotonic() - self._asked_at < PROBE_SECONDS:
            return
        try:
            self._tasks.tasks()
        except RobotKubeError as error:
            self._note_answer(error)
        else:
            self._note_answer(None)

    def _withdraw_pending(self) -> None:
        """Withdraw what was given up, once everything else is done, so that no start of such an event follows."""
        for identity, edge in list(self._pending_withdrawals.items()):
            if not self.reachable or self._orders.qsize() or self._stopping.is_set():
                return
            name = self._names.get(identity) or task_name(edge)
            try:
                if name not in [other for key, other in self._names.items() if key != identity]:
                    self._withdraw_task(edge, name)
                self._note_answer(None)
            except RobotKubeError as error:
                self._note_answer(error)
                if isinstance(error, UnavailableError):
                    continue
                log.error("task %s/%s: cannot be withdrawn: %s", self._namespace, name, error)
            del self._pending_withdrawals[identity]

    def _note_answer(self, error: RobotKubeError | None) -> None:
        """Note the outcome of a call to the API server: one that refuses is there."""
        self.reachable = not isinstance(error, UnavailableError)
        self._asked_at = self._monotonic()

    def _adopt(self) -> None:
        attempts = 0
        while not self._stopping.is_set():
            try:
                own_tasks = [(task, edge) for task in self._tasks.tasks() if (edge := event_of(task, self._requester))]
                for task, _ in own_tasks:
                    if parent_of(task) != self.parent:
                        self._withdraw(task["metadata"]["name"])
            except RobotKubeError as error:
                pause = backoff(attempts, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter)
                log.warning("reading own tasks failed: %s; trying again in %.1f s", error, pause)
                self._stopping.wait(pause)
                attempts += 1
                continue
            self._adopted_parent = self.parent
            adopted = self._take_over(own_tasks)
            self._note_answer(None)
            self.adopted = adopted
            return

    def _withdraw(self, name: str) -> None:
        """Delete what an earlier chain has left."""
        try:
            self._tasks.delete(name)
            log.info("task %s/%s: withdrawn, it belongs to another chain", self._namespace, name)
        except RefusalError as error:
            log.error("task %s/%s: of another chain, cannot be withdrawn: %s", self._namespace, name, error)

    def _take_over(self, own_tasks: Sequence[tuple[Mapping[str, Any], Edge]]) -> list[Edge]:
        """The events of this chain's tasks, the oldest first; their leases are renewed at once."""
        edges = []
        for task, edge in own_tasks:
            if parent_of(task) == self.parent:
                self._names[edge.id] = task["metadata"]["name"]
                self._keep_lease(task["metadata"]["name"], lease_seconds(task), self._monotonic())
                self._adopted_tasks[edge.rule, edge.agents] = task["metadata"]["name"]
                edges.append(edge)
        return sorted(edges, key=lambda edge: edge.time)

    def _keep_lease(self, name: str, seconds: int | None, due: float) -> None:
        if seconds is not None:
            self._leases[name] = _Lease(seconds, due)

    def _renew_leases(self) -> None:
        """Renew what is due; a task that somebody deleted is left alone."""
        now = self._monotonic()
        withdrawn = {self._names.get(identity) for identity in list(self._pending_withdrawals)}
        for name, lease in list(self._leases.items()):
            if lease.due > now or self._stopping.is_set() or name in withdrawn:
                continue
            try:
                if not self._tasks.renew(name, self._clock_ns()):
                    del self._leases[name]
                    continue
                lease.due = now + lease.seconds * RENEWED_SHARE
                self._note_answer(None)
            except RobotKubeError as error:
                self._note_answer(error)
                log.warning("task %s/%s: its lease was not renewed: %s", self._namespace, name, error)
                lease.due = now + min(RETRY_SECONDS_MAX, lease.seconds * RENEWED_SHARE)

    def _carry_out(self, order: _Order) -> None:
        record = order.record
        began = self._monotonic()
        attempts = 0
        while not self._stopping.is_set():
            try:
                self._attempt(order)
                self._delivered += 1
                self._note_answer(None)
                return
            except UnavailableError as error:
                self._note_answer(error)
                record.error = str(error)
                if self._monotonic() - began > TRY_SECONDS_MAX:
                    self._give_up(record, f"given up after {TRY_SECONDS_MAX:.0f} s: {error}")
                    self._retry_withdrawal(record.edge)
                    return
                pause = backoff(attempts, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter)
                log.warning("event %s: %s; trying again in %.1f s", record.edge.id, error, pause)
                self._retries += 1
                self._stopping.wait(pause)
                self._renew_leases()
                attempts += 1
            except RobotKubeError as error:
                self._give_up(record, str(error))
                return

    def _retry_withdrawal(self, edge: Edge) -> None:
        """Remember a withdrawal that was given up: else the task would be there, and its lease renewed, for ever."""
        if edge.edge != START and len(self._pending_withdrawals) < WITHDRAWALS_MAX:
            self._pending_withdrawals[edge.id] = edge

    def _give_up(self, record: EventRecord, reason: str) -> None:
        record.error = reason
        self._box.add(NAME, delivery_id(record.edge), reason)
        self._dead += 1

    def _attempt(self, order: _Order) -> None:
        record = order.record
        edge = record.edge
        if edge.edge != START:
            name = self._names.get(edge.id) or task_name(edge)
            self._withdraw_task(edge, name)
        elif edge.id in self._withdrawn and record.error is not None:
            return  # the API server was away as long as the event lasted
        else:
            assert order.reaction is not None
            name = self._create_task(order, order.reaction)
        record.task = f"{self._namespace}/{name}"
        record.done = self._clock_ns()
        record.error = None
        log.info(
            "event %s: %s rule=%s agents=%s task=%s stamp=%d time=%d done=%d",
            edge.id, edge.edge, edge.rule, ",".join(edge.agents), record.task, edge.stamp, edge.time, record.done,
        )  # fmt: skip

    def _create_task(self, order: _Order, reaction: OperatorReactionSettings) -> str:
        """Make the task of a start edge, or go on with the one that a predecessor made for the same agents."""
        edge = order.record.edge
        name = self._adopted_tasks.get((edge.rule, edge.agents), "")
        if not name or order.parent != self._adopted_parent:
            name = task_name(edge)
            self._tasks.create(event_task(self._requester, reaction, edge, order.reason, order.parent))
            self._keep_lease(name, reaction.lease_seconds, self._monotonic() + _share(reaction.lease_seconds))
        self._names[edge.id] = name
        return name

    def _withdraw_task(self, edge: Edge, name: str) -> None:
        self._leases.pop(name, None)
        self._tasks.delete(name)
        self._names.pop(edge.id, None)
        self._adopted_tasks.pop((edge.rule, edge.agents), None)
        self._withdrawn.discard(edge.id)


def _share(seconds: int | None) -> float:
    return (seconds or 0) * RENEWED_SHARE
