"""Deliveries of one reaction: a bounded queue, a thread of its own, and retries in order.

What the receiver does not accept for `retry_seconds`, refuses, or what does not fit into the queue is a dead letter.
The order of edges is kept, so that nobody is notified of an event's end before its begin: one that is tried again holds
up those behind it. What an earlier process has left comes first.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import random
import threading
from collections import deque
from collections.abc import Callable, Mapping

from robotkube.backoffs import Random, backoff
from robotkube.errors import RobotKubeError
from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
from robotkube.robots.reactions.loops.delivery_journal import OPEN_SECONDS_MAX, ReactionJournal
from robotkube.robots.reactions.ports.deliveries import DeliverySender, EdgeDelivery

QUEUE_MAX = 256
WAIT_SECONDS = 0.5
RETRY_SECONDS_FIRST, RETRY_SECONDS_LONGEST = 0.2, 10.0
ENDED = "the detector ended"
PROBE_SECONDS = 5.0
"""A receiver to which nothing was sent for so long is probed: it may be gone, or back."""

log = logging.getLogger(__name__)


class Deliveries:
    """The deliveries of one reaction by a sender (port RunningReaction)."""

    def __init__(
        self,
        name: str,
        sender: DeliverySender,
        retry_seconds: float,
        box: DeadLetterBox,
        monotonic: Callable[[], float],
        journal: ReactionJournal | None = None,
        jitter: Random = random.random,
    ) -> None:
        self.name = name
        self._sender = sender
        self._retry_seconds = retry_seconds
        self._box = box
        self._monotonic = monotonic
        self._jitter = jitter
        self._queue: queue.Queue[EdgeDelivery | None] = queue.Queue(QUEUE_MAX)  # None: check whether the end has come
        self._journal = journal or ReactionJournal()
        self._earlier = deque[EdgeDelivery]()
        self._ending = threading.Event()
        self._deadline = float("inf")
        self._delivered = self._retries = self._dead = self._in_progress = self._undelivered = 0
        self._contacted_at = float("-inf")
        self.unreachable = f"{name}: not tried yet"
        self._thread = threading.Thread(target=self._run, name=f"deliveries {name}", daemon=True)

    def start(self) -> None:
        """Start the thread that delivers."""
        self._thread.start()

    def react(self, delivery: EdgeDelivery) -> None:
        """See the port."""
        self._journal.add(delivery)
        try:
            self._queue.put_nowait(delivery)
        except queue.Full:
            self._give_up(delivery, f"{QUEUE_MAX} edges wait already")

    def counts(self) -> Mapping[str, int]:
        """See the port."""
        waiting = self._queue.qsize() + len(self._earlier) + self._in_progress
        return {"delivered": self._delivered, "retries": self._retries, "dead": self._dead, "waiting": waiting}

    def stop(self, seconds: float) -> bool:
        """See the port."""
        dead_before = self._dead
        self._deadline = self._monotonic() + seconds
        self._ending.set()
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(None)
        self._thread.join(seconds)
        while self._earlier:
            self._leave_to_successor(self._earlier.popleft(), ENDED)
        while True:
            try:
                if delivery := self._queue.get_nowait():
                    self._leave_to_successor(delivery, ENDED)
            except queue.Empty:
                return self._dead == dead_before and not (self._undelivered or self._thread.is_alive())

    def _run(self) -> None:
        self._journal.wait(OPEN_SECONDS_MAX)
        self._await_receiver()
        while (delivery := self._next()) is not None:
            self._in_progress = 1
            self._deliver(delivery)
            self._contacted_at = self._monotonic()
            self._in_progress = 0
        self._sender.close()

    def _next(self) -> EdgeDelivery | None:
        """The next delivery; None when the time to end has come."""
        while True:
            over = self._ending.is_set()
            self._earlier.extend(self._journal.from_predecessor())
            if over and self._monotonic() >= self._deadline:
                return None
            if self._earlier:
                return self._earlier.popleft()
            try:
                if delivery := self._queue.get(timeout=0.001 if over else WAIT_SECONDS):
                    return delivery
            except queue.Empty:
                if over:
                    return None
            if self._monotonic() - self._contacted_at >= PROBE_SECONDS:
                self._probe()

    def _await_receiver(self) -> None:
        """Probe the receiver until it answers or there is something to deliver; /readyz waits for it."""
        attempts = 0
        while not (self._ending.is_set() or self._earlier) and self._queue.empty():
            self._earlier.extend(self._journal.from_predecessor())
            if self._probe():
                return
            self._ending.wait(backoff(attempts, RETRY_SECONDS_FIRST, RETRY_SECONDS_LONGEST, self._jitter))
            attempts += 1

    def _probe(self) -> bool:
        """Probe the receiver once; True when it is within reach."""
        try:
            self._sender.probe()
        except RobotKubeError as error:
            self.unreachable = f"{self.name}: {error}"
        else:
            self.unreachable = ""
        self._contacted_at = self._monotonic()
        return not self.unreachable

    def _deliver(self, delivery: EdgeDelivery) -> None:
        began = self._monotonic()
        attempts = 0
        while True:
            try:
                self._sender.send(delivery)
            except RobotKubeError as error:
                now = self._monotonic()
                pause = backoff(attempts, RETRY_SECONDS_FIRST, RETRY_SECONDS_LONGEST, self._jitter)
                over = now - began + pause > self._retry_seconds
                if error.retriable:
                    self.unreachable = f"{self.name}: {error}"
                if over or not error.retriable:
                    self._give_up(delivery, str(error))
                    return
                if now + pause > self._deadline:
                    self._leave_to_successor(delivery, str(error))
                    return
                self._retries += 1
                log.warning("reaction %s: %s: %s; trying again in %.1f s", self.name, delivery.id, error, pause)
                self._pause(pause)
                attempts += 1
            else:
                self._delivered += 1
                self._journal.done(delivery)
                self.unreachable = ""
                return

    def _pause(self, seconds: float) -> None:
        """Wait so long; the detector's end cuts it short once."""
        ending = self._ending
        (threading.Event() if ending.is_set() else ending).wait(seconds)

    def _leave_to_successor(self, delivery: EdgeDelivery, reason: str) -> None:
        """Leave a delivery to the next process when that will find it, else give it up."""
        self._undelivered += 1
        if self._journal.outlives(delivery):
            log.warning("reaction %s: %s is left to the next process: %s", self.name, delivery.id, reason)
        else:
            self._give_up(delivery, reason)

    def _give_up(self, delivery: EdgeDelivery, reason: str) -> None:
        self._box.add(self.name, delivery.id, reason)
        self._dead += 1
        self._journal.done(delivery)
