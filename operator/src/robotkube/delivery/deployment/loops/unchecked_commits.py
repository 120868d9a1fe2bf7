"""Commits that stand on main although the gate did not check them: found from Git alone, whenever main has moved."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from robotkube.delivery.deployment.core.break_glass import ACCEPTED_PATH, SIGNERS_PATH, read_accepted
from robotkube.delivery.deployment.core.merge_records import MergeRecord, read_record
from robotkube.delivery.deployment.core.unchecked_commits import (
    ACCEPTED,
    NO_RECORD,
    REPLACED,
    GlassClaim,
    Holds,
    UncheckedCommit,
    covered_by,
    judge_claim,
    last_checked,
    records_problem,
    says_break_glass,
)
from robotkube.errors import DocumentError, InputError
from robotkube.foundation.forge.ports.repositories import MainBranch, NoteTexts
from robotkube.registry.evidence.ports import Verifier

MADE_GOOD_MAX = 50  # of those that stand no more
COMMITS_MAX = 10_000  # how far back main is searched for them
RECHECK_SECONDS = 30.0  # a record that is missing may come: a gate that ends in between writes it when it is back
POLICIES = "policies"
PROTECTED = (SIGNERS_PATH, ACCEPTED_PATH)
EVERYTHING = "everything"

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Trust:
    """What is believed about commits of `repository` (`<organisation>/<name>`): records with these keys, and people's
    signatures as `holds` checks them."""

    repository: str
    verifier: Verifier
    holds: Holds


class UncheckedWatch:
    """The commits of one main that the gate did not check and that stand: main still has a file as one of them brought
    it, and no checked commit has accepted it; and the newest of those that stand no more (`made_good`). `clock` counts
    seconds; records that are missing are asked for again after `recheck_seconds`.

    Read again when main moved. Not for several threads."""

    def __init__(
        self,
        main: MainBranch,
        notes: NoteTexts,
        trust: Trust,
        clock: Callable[[], float],
        recheck_seconds: float = RECHECK_SECONDS,
    ) -> None:
        self._main = main
        self._notes = notes
        self._trust = trust
        self._clock = clock
        self._recheck_seconds = recheck_seconds
        self._forget()
        self.standing: tuple[UncheckedCommit, ...] = ()
        self.made_good: tuple[UncheckedCommit, ...] = ()

    def _forget(self) -> None:
        self._commits: list[str] = []  # main's, oldest first
        self._places: dict[str, int] = {}
        self._open: dict[str, str] = {}  # commit without a record -> its message
        self._expected: set[str] = set()  # of the gate itself, and not read yet
        self._records: dict[str, MergeRecord] = {}
        self._problems: dict[str, str] = {}  # commit -> why its record is not believed
        self._judged_by: dict[tuple[str, str], UncheckedCommit] = {}  # commit, and whose policies it is judged by
        self._first = -1  # place of the first commit that has a record
        self._asked_at = float("-inf")

    def expect(self, commit: str) -> None:
        """Note that the gate itself has checked a commit and moves main to it: its record comes."""
        self._expected.add(commit)

    def drop(self, commit: str) -> None:
        """Note that the gate has not moved main to a commit that it expected."""
        self._expected.discard(commit)

    @property
    def tip(self) -> str:
        """Main's tip as it was read last; empty when there was no main."""
        return self._commits[-1] if self._commits else ""

    @property
    def before_records(self) -> int:
        """How many commits came before the first record, but for main's first."""
        return max(0, (self._first if self._first >= 0 else len(self._commits)) - 1)

    @property
    def problem(self) -> str:
        """What is wrong with all records together, a sentence; empty when nothing is."""
        return records_problem(self._records.values(), len(self._commits) > 1)

    @property
    def unrecorded(self) -> bool:
        """Return whether a record is missing, which may still come."""
        return any(one.how == NO_RECORD for one in self.standing) or (self._first < 0 and len(self._commits) > 1)

    def read(self) -> bool:
        """Read main's new commits, and what records are missing; whether what stands has changed.

        UnavailableError when the forge does not answer, InputError when a key cannot be read; the next time begins
        where this one did."""
        tip = self._main.tip
        new = self._new_commits(tip)
        again = self._missing() and self._clock() >= self._asked_at + self._recheck_seconds
        if not new and not again:
            return False
        foreign = [commit for commit in new if commit not in self._expected]
        asks = bool(foreign) or again
        self._trust.verifier.trusted()
        texts = self._notes.texts([*self._open, *foreign]) if asks else {}
        self._add(new)
        self._cover(texts)
        self._asked_at = self._clock() if asks else self._asked_at
        before = self.standing
        self.standing, self.made_good = self._read_standing(tip) if self._open else ((), ())
        return self.standing != before

    def _new_commits(self, tip: str) -> dict[str, str]:
        """Commits with their messages since the last time, oldest first; all of them when main was rewritten."""
        known = self.tip
        if tip in ("", known):
            return {}
        new = list(self._main.headers(known, COMMITS_MAX))
        if known and self._main.shape(new[-1][0]).parents[:1] != (known,):  # the walk along first parents missed it
            log.error("main was rewritten before=%s after=%s", known[:12], tip[:12])
            expected = self._expected
            self._forget()
            self._expected = expected
        return dict(reversed(new))

    def _add(self, new: dict[str, str]) -> None:
        for commit, message in new.items():
            self._places[commit] = len(self._commits)
            self._commits.append(commit)
            if commit in self._expected:
                self._has_record(commit)
            else:
                self._open[commit] = message

    def _has_record(self, commit: str) -> None:
        self._open.pop(commit, None)
        self._expected.discard(commit)
        place = self._places[commit]
        self._first = place if self._first < 0 else min(self._first, place)

    def _cover(self, texts: Mapping[str, str]) -> None:
        """Take the commits that valid records are about, and those that they cover, from the open ones."""
        for commit, text in texts.items():
            try:
                record = read_record(self._trust.verifier.verify(text.encode("utf-8", "surrogatepass")))
            except InputError as error:
                self._problems[commit] = str(error)
                continue
            if record.commit != commit:
                self._problems[commit] = f"it is the record of {record.commit}"
                continue
            self._records[commit] = record
            for one in covered_by(record, self._commits, self._places):
                self._has_record(one)
        self._open = {commit: text for commit, text in self._open.items() if self._matters(commit)}

    def _matters(self, commit: str) -> bool:
        """Return whether something is to be said about a commit without a record, or may be once others have theirs."""
        return says_break_glass(self._open[commit]) or self._first < 0 or self._places[commit] > self._first

    def _missing(self) -> bool:
        """Return whether a commit should have a record, or main a first one."""
        return any(self._first < 0 or self._places[commit] > self._first for commit in self._open)

    # -- what stands ----------------------------------------------------------------------------------------------

    def _read_standing(self, tip: str) -> tuple[tuple[UncheckedCommit, ...], tuple[UncheckedCommit, ...]]:
        """Those of the open commits that stand, newest first, with the files, and those that stand no more; a file
        counts for the newest alone."""
        accepted = self._accepted(tip)
        counted: set[str] = set()
        standing: list[UncheckedCommit] = []
        made_good: list[UncheckedCommit] = []
        unchecked = [commit for commit in reversed(self._open) if self._is_unchecked(commit)]
        for commit in unchecked:
            files = tuple(path for path in self._files(commit) if path not in counted)
            counted.update(files)
            if files and commit not in accepted:
                standing.append(replace(self._judged(commit, unchecked), files=files))
            elif len(made_good) < MADE_GOOD_MAX:
                how = ACCEPTED if commit in accepted else REPLACED
                made_good.append(replace(self._judged(commit, unchecked), made_good=how))
        return tuple(standing), tuple(made_good)

    def _is_unchecked(self, commit: str) -> bool:
        return says_break_glass(self._open[commit]) or self._places[commit] > self._first >= 0

    def _judged(self, commit: str, unchecked: Sequence[str]) -> UncheckedCommit:
        message = self._open[commit]
        if not says_break_glass(message):
            return UncheckedCommit(
                commit, NO_RECORD, message.partition("\n")[0], problem=self._problems.get(commit, "")
            )
        base = last_checked(self._commits, self._places[commit], unchecked)
        if (commit, base) not in self._judged_by:
            self._judged_by[commit, base] = self._judge(commit, base, message)
        return self._judged_by[commit, base]

    def _judge(self, commit: str, base: str, message: str) -> UncheckedCommit:
        shape = self._main.shape(commit)
        signers = self._policies(base).get(SIGNERS_PATH, "") if base else ""
        protected = self._protected(commit, shape.parents)
        claim = GlassClaim(commit, self._trust.repository, shape.parents, shape.tree, message, protected)
        return judge_claim(claim, signers, self._trust.holds)

    def _policies(self, commit: str) -> dict[str, str]:
        return dict(self._main.files(commit, (POLICIES,)))

    def _protected(self, commit: str, parents: Sequence[str]) -> tuple[str, ...]:
        """Those files of PROTECTED that a commit changes."""
        before = self._policies(parents[0]) if parents else {}
        after = self._policies(commit)
        return tuple(path for path in PROTECTED if before.get(path) != after.get(path))

    def _files(self, commit: str) -> Sequence[str]:
        """The files that main still has as the commit brought them; of one that is too large to compare, EVERYTHING,
        which nothing but its acceptance takes away."""
        try:
            return self._main.still_as_in(commit)
        except DocumentError as error:
            log.error("an unchecked commit cannot be compared commit=%s problem=%r", commit, str(error))
            return (f"{EVERYTHING} of {commit[:12]}",)

    def _accepted(self, tip: str) -> frozenset[str]:
        try:
            return read_accepted(self._policies(tip).get(ACCEPTED_PATH, ""))
        except DocumentError as error:
            log.error("accepted commits unusable commit=%s problem=%r", tip[:12], str(error))
            return frozenset()  # what cannot be read accepts nothing
