"""The facts that a manager observed of its plan, copied from its closing comment to Git's notes (refs/notes/robotkube).

Only the gate may write them: it takes the comment of the pull request's own author, who must be a manager, about a
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
LOOK_SECONDS = 600.0  # closed pull requests, in case a delivery of the forge was lost
RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 10.0, 60.0  # after a round that failed
HINTS_MAX = 2000

log = logging.getLogger(__name__)


class NoteWriter:
    """`managers` are the accounts whose words count; `monotonic` is a clock in seconds that never goes back."""

    def __init__(
        self,
        forge: Forge,
        notes: Notes,
        managers: Collection[str],
        monotonic: Callable[[], float],
        jitter: Random = random.random,
    ) -> None:
        self._jitter, self._failures = jitter, 0
        self._forge, self._notes, self._managers, self._monotonic = forge, notes, frozenset(managers), monotonic
        self._hints: dict[int, None] = {}
        self._lock, self._woken = threading.Lock(), threading.Event()
        self.written = 0

    def commented(self, number: int) -> None:
        """Somebody commented on that pull request."""
        with self._lock:
            if len(self._hints) < HINTS_MAX:
                self._hints[number] = None
        self._woken.set()

    def stop(self, stopping: threading.Event) -> None:
        """End `run` after the round that is under way."""
        stopping.set()
        self._woken.set()

    def run(self, stopping: threading.Event) -> None:
        """Rounds until `stopping` is set; what fails is tried again after at most RETRY_SECONDS_MAX."""
        looked_at = float("-inf")
        while not stopping.is_set():
            self._woken.clear()
            look, pause = self._monotonic() - looked_at >= LOOK_SECONDS, LOOK_SECONDS
            looked_at = self._monotonic() if look else looked_at
            try:
                self.round(look)
                self._failures = 0
            except RobotKubeError as error:
                log.warning("notes not written reason=%s", error)
                looked_at = float("-inf")
                pause = backoff(self._failures, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter)
                self._failures += 1
            self._woken.wait(pause)
            stopping.wait(GATHER_SECONDS)

    def round(self, look: bool) -> None:
        """Write the notes that are due: of pull requests with a new comment and, to `look`, of the newest closed.

        What the forge or Git refuses is due again."""
        with self._lock:
            numbers, self._hints = list(self._hints), {}
        try:
            self._write(numbers, look)
        except RobotKubeError:
            with self._lock:
                self._hints = dict.fromkeys(numbers) | self._hints
            raise

    def _write(self, numbers: Sequence[int], look: bool) -> None:
        pulls = [self._forge.pull_request(number) for number in numbers]
        pulls += [pull for pull in self._forge.pull_requests("closed") if look] if look else []
        wanted = {pull.head: pull for pull in pulls if pull.merged and pull.author in self._managers}
        missing = self._notes.missing(list(wanted)) if wanted else []
        found = {commit: text for commit in missing if (text := self._note(wanted[commit], commit)) is not None}
        if found:
            self._notes.add(found)
            self.written += len(found)
            log.info("notes written commits=%d", len(found))

    def _note(self, pull: PullRequest, commit: str) -> str | None:
        texts = [comment.text for comment in self._forge.comments(pull.number) if comment.author == pull.author]
        return next((note for text in texts if (note := read_note(text, commit)) is not None), None)
