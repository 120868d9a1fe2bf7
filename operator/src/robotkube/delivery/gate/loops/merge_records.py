"""The recorder of merges: what the gate checked and merged becomes a signed note of its commit.

The gate says what it is about to merge before it moves main, and no plan waits for more than that. The recorder signs
and pushes on a thread of its own. What was announced is kept on disk until its note stands, so a gate that ends in
between writes the note in its next start, if main has the commit then.
"""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from robotkube.backoffs import Random, backoff
from robotkube.delivery.deployment.core.merge_records import (
    OUTCOMES_REFERENCE,
    REFERENCE,
    MergeRecord,
    record_statement,
)
from robotkube.errors import RobotKubeError
from robotkube.foundation.forge.ports.repositories import Notes
from robotkube.registry.evidence.ports import Signer

GATHER_SECONDS = 2.0  # merges within this time become one push
RETRY_SECONDS_FIRST = 2.0
RETRY_SECONDS_MAX = 60.0
RECORDS_MAX = 500  # of one push

log = logging.getLogger(__name__)


class MergeJournal(Protocol):
    """Records that have no note yet, kept over a restart of the process. InputError when the disk refuses."""

    def keep(self, record: MergeRecord) -> None:
        """Keep a record, in place of an earlier one about the same commit."""
        ...

    def forget(self, commit: str) -> None:
        """Forget the record about a commit; nothing happens when there is none."""
        ...

    def records(self) -> Sequence[MergeRecord]:
        """All records that are kept."""
        ...


class MainContents(Protocol):
    """Main, to see which commits it has."""

    def fetch(self) -> str:
        """Bring main's tip here."""
        ...

    def contains(self, commit: str) -> bool:
        """Return whether `commit` is on main; InputError when it is not here at all."""
        ...


class MergeRecorder:
    """Writes the records of one gate; `expect`, `merged`, `dropped` and `unsure` are called by the gate, `run` has a
    thread of its own. `repository` is the URL of the deployment repository, `verifier` the name in statements; `now`
    gives the time in RFC 3339; `written` counts records since the start."""

    def __init__(
        self,
        notes: Notes,
        main: MainContents,
        journal: MergeJournal,
        signer: Signer,
        repository: str,
        verifier: str,
        now: Callable[[], str],
        jitter: Random = random.random,
    ) -> None:
        self._notes = notes
        self._main = main
        self._journal = journal
        self._signer = signer
        self._names = (repository, verifier)
        self._now = now
        self._jitter = jitter
        self._due: dict[str, MergeRecord] = {}
        self._under_way: set[str] = set()
        self._unsure = True  # the journal has what an earlier process, or a push without an answer, left
        self._lock = threading.Lock()
        self._woken = threading.Event()
        self._failures = 0
        self.written = 0

    def expect(self, record: MergeRecord) -> MergeRecord:
        """Keep what the gate is about to merge; the record with the present time."""
        record = replace(record, time=self._now())
        with self._lock:
            self._under_way.add(record.commit)
        self._journal.keep(record)
        return record

    def announced(self) -> frozenset[str]:
        """Commits that this gate, or the one before it, was about to merge, and that may have no note yet."""
        return frozenset(record.commit for record in self._journal.records())

    def merged(self, record: MergeRecord) -> None:
        """Main has moved to the commit: its record is due."""
        with self._lock:
            self._due[record.commit] = record
            self._under_way.discard(record.commit)
        self._woken.set()

    def dropped(self, record: MergeRecord) -> None:
        """Main has not moved to the commit."""
        with self._lock:
            self._under_way.discard(record.commit)
        self._journal.forget(record.commit)

    def unsure(self, record: MergeRecord) -> None:
        """The forge gave no answer: the next round sees whether main has the commit."""
        with self._lock:
            self._under_way.discard(record.commit)
            self._unsure = True
        self._woken.set()

    def stop(self, stopping: threading.Event) -> None:
        """End `run` after a last round."""
        stopping.set()
        self._woken.set()

    def run(self, stopping: threading.Event) -> None:
        """Run rounds until `stopping` is set, and one more then; what fails is tried again."""
        while True:
            last = stopping.is_set()
            self._woken.clear()
            pause: float | None = None
            try:
                self.round()
                self._failures = 0
            except RobotKubeError as error:
                log.warning("merges not recorded count=%d reason=%s", len(self._due), error)
                pause = backoff(self._failures, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter)
                self._failures += 1
            if last:
                return
            self._woken.wait(pause)
            stopping.wait(GATHER_SECONDS)

    def round(self) -> None:
        """Write the records that are due, at most RECORDS_MAX at once; what Git or the forge refuses stays due."""
        if self._unsure:
            self._recover()
        with self._lock:
            due = dict(list(self._due.items())[:RECORDS_MAX])
        if not due:
            return
        missing = set(self._notes.missing(list(due)))
        outcomes, records = (self._notes.tip(name) for name in (OUTCOMES_REFERENCE, REFERENCE))
        signed = {c: self._signed(record.anchored(outcomes, records)) for c, record in due.items() if c in missing}
        if signed:
            self._notes.add(signed)
            self.written += len(signed)
            log.info("merges recorded commits=%d", len(signed))
        with self._lock:
            for commit in due:
                del self._due[commit]
        for commit in due:
            self._journal.forget(commit)
        if len(due) == RECORDS_MAX:
            self._woken.set()

    def _signed(self, record: MergeRecord) -> str:
        return self._signer.sign(record_statement(record, *self._names)).decode("ascii")

    def _recover(self) -> None:
        """What was announced without a known end is due if main has it, and forgotten if not."""
        with self._lock:
            self._unsure = False
        kept = self._journal.records()
        with self._lock:  # after the journal was read: what is announced meanwhile is under way
            known = {*self._under_way, *self._due}
        earlier = [record for record in kept if record.commit not in known]
        try:
            if earlier:
                self._main.fetch()
        except RobotKubeError:
            self._unsure = True
            raise
        on_main: Mapping[str, MergeRecord] = {r.commit: r for r in earlier if self._on_main(r.commit)}
        for record in earlier:
            if record.commit not in on_main:
                self._journal.forget(record.commit)
        with self._lock:
            self._due = {**on_main, **self._due}

    def _on_main(self, commit: str) -> bool:
        try:
            return self._main.contains(commit)
        except RobotKubeError:
            return False
