"""Which commits of main the gate signed for, and what its records say against main, catalogue and notes as they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from robotkube.delivery.audit.core.findings import Finding, short
from robotkube.delivery.audit.core.main_replay import CLOCK_SECONDS_MAX
from robotkube.delivery.deployment.core.merge_records import (
    OUTCOMES_REFERENCE,
    REFERENCE,
    MergeRecord,
    read_record,
)
from robotkube.delivery.deployment.core.unchecked_commits import says_break_glass
from robotkube.errors import InputError
from robotkube.foundation.documents.core.times import time_ns
from robotkube.foundation.forge.core.histories import HistoryCommit, NoteHistory
from robotkube.registry.evidence.core.statements import VerifiedStatement

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Merges:
    """What the records say: `records` commit -> its valid record, also of the commits that a pull request of several
    brought; `unsigned` how many commits came before the first record."""

    records: Mapping[str, MergeRecord] = field(default_factory=dict)
    unsigned: int = 0
    findings: tuple[Finding, ...] = ()


def without_record(commits: Sequence[HistoryCommit], records: Mapping[str, MergeRecord]) -> frozenset[str]:
    """Commits whose gate should have signed, and those that say that they are break-glass, without a record."""
    first = next((place for place, commit in enumerate(commits) if commit.id in records), len(commits))
    return frozenset(
        commit.id
        for place, commit in enumerate(commits)
        if commit.id not in records and (place > first or says_break_glass(commit.message))
    )


def main_moves(statements: Mapping[str, VerifiedStatement | str]) -> Mapping[str, str]:
    """Commit -> where main stood before the gate moved it there, by all records that hold."""
    moves: dict[str, str] = {}
    for annotated, statement in statements.items():
        if isinstance(statement, VerifiedStatement):
            try:
                record = read_record(statement)
            except InputError:
                continue
            if record.commit == annotated and record.previous:
                moves[annotated] = record.previous
    return moves


def check_merges(
    commits: Sequence[HistoryCommit],
    statements: Mapping[str, VerifiedStatement | str],
    records: NoteHistory,
    outcomes: NoteHistory,
    catalogue: frozenset[str],
) -> Merges:
    """The records of main's `commits` (oldest first). `statements`: annotated commit -> its record's statement, or why
    that is not believed; `records` and `outcomes` are both references with notes, `catalogue` all commits of the
    catalogue's main."""
    places = {commit.id: place for place, commit in enumerate(commits)}
    findings: list[Finding] = [*_edits(records, REFERENCE)]
    valid: dict[str, MergeRecord] = {}
    for annotated, statement in sorted(statements.items(), key=lambda item: places.get(item[0], len(places))):
        record, of_record = _record(annotated, statement, places)
        findings += of_record
        if record is not None:
            valid[annotated] = record
    covered: dict[str, MergeRecord] = {}
    for record in valid.values():
        findings += _against_main(record, commits, places, covered)
        findings += _anchors(record, records, outcomes, catalogue)
    first = min((places[commit] for commit in covered), default=len(commits))
    findings += _first(valid, commits, places)
    findings += _unchecked(commits, covered, first)
    return Merges(covered, sum(bool(c.parents) for c in commits[:first]), tuple(findings))


def _edits(notes: NoteHistory, reference: str) -> Iterator[Finding]:
    for edit in notes.edits:
        word = "removed" if edit.removed else "changed"
        what = f"the note of {short(edit.annotated)} was {word} by {short(edit.by)} of {reference}"
        yield Finding("note-edited", "deployment", f"note of {edit.annotated}", what, edit.annotated)


def _record(
    annotated: str, statement: VerifiedStatement | str, places: Mapping[str, int]
) -> tuple[MergeRecord | None, list[Finding]]:
    where = f"record of {annotated}"
    if isinstance(statement, str):
        return None, [Finding("record-not-valid", "deployment", where, statement, annotated)]
    try:
        record = read_record(statement)
    except InputError as error:
        return None, [Finding("record-not-valid", "deployment", where, str(error), annotated)]
    if record.commit != annotated:
        what = f"it is the record of {record.commit}"
        return None, [Finding("record-of-other-commit", "deployment", where, what, annotated)]
    if annotated not in places:
        what = f"pull request {record.pull_request} by {record.author}, merged at {record.time}"
        return None, [Finding("record-off-main", "deployment", where, what, annotated)]
    return record, []


def _against_main(
    record: MergeRecord,
    commits: Sequence[HistoryCommit],
    places: Mapping[str, int],
    covered: dict[str, MergeRecord],
) -> Iterator[Finding]:
    """Note the commits that a record covers: those after the one that main stood at."""
    where = f"record of {record.commit}"
    last = places[record.commit]
    first = places.get(record.previous, -1) + 1 if record.previous else 0
    if (record.previous and record.previous not in places) or first > last:
        what = f"main stood at {short(record.previous)} before"
        yield Finding("record-contradicts-main", "deployment", where, what, record.commit)
        first = last
    for commit in commits[first : last + 1]:
        covered.setdefault(commit.id, record)
    late = commits[last].committed - time_ns(record.time) // SECOND_NS
    if late > CLOCK_SECONDS_MAX:
        what = f"the commit says that it was made {late} s after the gate merged it"
        yield Finding("time-order", "deployment", where, what, record.commit)


def _anchors(
    record: MergeRecord, records: NoteHistory, outcomes: NoteHistory, catalogue: frozenset[str]
) -> Iterator[Finding]:
    where = f"record of {record.commit}"
    for name, tip, notes in (
        (REFERENCE, record.records, records),
        (OUTCOMES_REFERENCE, record.outcomes, outcomes),
    ):
        if tip and tip not in notes.commits:
            what = f"{name} stood at {short(tip)}, which it does not have any more"
            yield Finding("notes-replaced", "deployment", where, what, record.commit)
    if record.catalogue and record.catalogue not in catalogue:
        what = f"it was decided by commit {short(record.catalogue)} of the catalogue"
        yield Finding("catalogue-rewritten", "catalogue", where, what, record.commit)


def _first(
    valid: Mapping[str, MergeRecord], commits: Sequence[HistoryCommit], places: Mapping[str, int]
) -> Iterator[Finding]:
    """The oldest record must say that there was none before it."""
    if not valid:
        if any(commit.parents for commit in commits):
            yield Finding("no-records", "deployment", REFERENCE, "main has no commit with a valid record of the gate")
        return
    if all(record.records for record in valid.values()):
        oldest = min(valid.values(), key=lambda record: places[record.commit])
        what = f"it says that there were others before it ({short(oldest.records)})"
        yield Finding("records-removed", "deployment", f"record of {oldest.commit}", what, oldest.commit)


def _unchecked(commits: Sequence[HistoryCommit], covered: Mapping[str, MergeRecord], first: int) -> Iterator[Finding]:
    for commit in commits[first:]:
        if commit.id not in covered and not says_break_glass(commit.message):
            what = f"{commit.subject!r}, by {commit.author}"
            yield Finding("unchecked-commit", "deployment", f"commit {commit.id}", what, commit.id)
