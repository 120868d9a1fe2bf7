"""The writer of plan notes: copies the outcome comments of managers to Git's notes (refs/notes/robotkube).

Only the gate may write them: it copies the comment of the pull request's own author, who must be a manager, about a
commit that is on main, once. It works on a thread of its own, since no plan shall wait for it.
"""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable, Collection, Sequence

from robotkube.backoffs import Random, backoff
from robotkube.delivery.deployment.core.plan_notes import read_note
from robotkube.errors import RobotKubeError
from robotkube.foundation.forge.ports.pull_requests import Forge, PullRequest
from robotkube.foundation.forge.ports.repositories import Notes

GATHER_SECONDS = 2.0  # comments that come within this time become one push
RESYNC_SECONDS = 600.0  # closed pull requests, in case a delivery of the forge was lost
RETRY_SECONDS_FIRST = 10.0  # after a round that failed
RETRY_SECONDS_MAX = 60.0
HINTS_MAX = 2000

log = logging.getLogger(__name__)


class NoteWriter:
    """Writes the notes of merged plans; `run` on one thread, `commented` from any.

    `managers` are the accounts whose comments count; `monotonic` is a clock in seconds that never goes back;
    `written` counts the notes since the start."""

    def __init__(
        self,
        forge: Forge,
        notes: Notes,
        managers: Collection[str],
        monotonic: Callable[[], float],
        jitter: Random = random.random,
    ) -> None:
        self._forge = forge
        self._notes = notes
        self._managers = frozenset(managers)
        self._monotonic = monotonic
        self._jitter = jitter
        self._failures = 0
        self._hints: dict[int, None] = {}
        self._lock = threading.Lock()
        self._woken = threading.Event()
        self.written = 0

    def commented(self, number: int) -> None:
        """Note that somebody commented on that pull request: the next round reads its comments, and comes now."""
        with self._lock:
            if len(self._hints) < HINTS_MAX:
                self._hints[number] = None
        self._woken.set()

    def stop(self, stopping: threading.Event) -> None:
        """End `run` after the round that is under way."""
        stopping.set()
        self._woken.set()

    def run(self, stopping: threading.Event) -> None:
        """Run rounds until `stopping` is set; what fails is tried again after at most RETRY_SECONDS_MAX."""
        resynced_at = float("-inf")
        while not stopping.is_set():
            self._woken.clear()
            resync = self._monotonic() - resynced_at >= RESYNC_SECONDS
            resynced_at = self._monotonic() if resync else resynced_at
            pause = RESYNC_SECONDS
            try:
                self.round(resync)
                self._failures = 0
            except RobotKubeError as error:
                log.warning("notes not written reason=%s", error)
                resynced_at = float("-inf")
                pause = backoff(self._failures, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter)
                self._failures += 1
            self._woken.wait(pause)
            stopping.wait(GATHER_SECONDS)

    def round(self, resync: bool) -> None:
        """Write the notes that are due: of pull requests with a new comment and, in a `resync`, of the newest closed.

        What the forge or Git refuses is due again."""
        with self._lock:
            numbers = list(self._hints)
            self._hints = {}
        try:
            self._write(numbers, resync)
        except RobotKubeError:
            with self._lock:
                self._hints = dict.fromkeys(numbers) | self._hints
            raise

    def _write(self, numbers: Sequence[int], resync: bool) -> None:
        pulls = [self._forge.pull_request(number) for number in numbers]
        pulls += self._forge.pull_requests("closed") if resync else []
        merged = {pull.head: pull for pull in pulls if pull.merged and pull.author in self._managers}
        missing = self._notes.missing(list(merged)) if merged else []
        notes = {commit: text for commit in missing if (text := self._note(merged[commit], commit)) is not None}
        if notes:
            self._notes.add(notes)
            self.written += len(notes)
            log.info("notes written commits=%d", len(notes))

    def _note(self, pull: PullRequest, commit: str) -> str | None:
        """The note in the comments of a pull request's own author; None when there is none about that commit."""
        texts = [comment.text for comment in self._forge.comments(pull.number) if comment.author == pull.author]
        return next((note for text in texts if (note := read_note(text, commit)) is not None), None)
