"""The gate's records of merges: what is signed, when it is due, and that no merge loses its record; without a forge."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from robotkube.delivery.deployment.core.merge_records import (
    OUTCOMES_REFERENCE,
    REFERENCE,
    MergeRecord,
    read_record,
    record_statement,
)
from robotkube.delivery.gate.adapters.merge_journal import FileJournal
from robotkube.delivery.gate.loops import merge_records
from robotkube.delivery.gate.loops.merge_records import MergeRecorder
from robotkube.errors import InputError, UnavailableError
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.evidence.core.statements import VerifiedStatement, assess
from tests.stages.registry.signed_evidence import POLICY, Signing, artefact, listing, signing_key, trusting

FIRST, SECOND = "1" * 40, "2" * 40
MAIN, CATALOGUE, NOTES = "a" * 40, "b" * 40, "c" * 40
NOW = "2026-11-18T11:06:40Z"
RECORD = MergeRecord(FIRST, MAIN, "manager", "automatic", "7", (), "", CATALOGUE)


class Notes:
    """The notes at the forge; the next `away` pushes are not answered."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self.away = 0
        self.pushes = 0
        self.written = threading.Event()

    def missing(self, commits: Sequence[str]) -> list[str]:
        return [commit for commit in commits if commit not in self.texts]

    def tip(self, reference: str) -> str:
        return NOTES if reference == OUTCOMES_REFERENCE or self.texts else ""

    def add(self, texts: Mapping[str, str]) -> None:
        if self.away:
            self.away -= 1
            raise UnavailableError("notes: push: no answer")
        self.pushes += 1
        self.texts.update(texts)
        self.written.set()


class Main:
    """Main as the recorder sees it."""

    def __init__(self, *commits: str) -> None:
        self.commits = set(commits)
        self.away = False

    def fetch(self) -> str:
        if self.away:
            raise UnavailableError("git: fetch: no answer")
        return MAIN

    def contains(self, commit: str) -> bool:
        if commit not in self.commits:
            raise InputError("not here")
        return True


class Stage:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.notes = Notes()
        self.main = Main()
        self.key = signing_key(folder / "key", 1)
        self.keys = trusting(folder / "keys", self.key)
        self.recorder = self.started()

    def started(self) -> MergeRecorder:
        """A recorder as a new process has it."""
        journal = FileJournal(self.folder / "merges")
        return MergeRecorder(
            self.notes, self.main, journal, self.key, "http://forge/d", "gate", lambda: NOW, lambda: 0.0
        )

    def merge(self, commit: str = FIRST) -> None:
        self.recorder.merged(self.recorder.expect(replace(RECORD, commit=commit)))

    def recorded(self) -> dict[str, MergeRecord]:
        """The records at the forge, their signatures verified."""
        return {c: read_record(self.keys.verify(text.encode())) for c, text in self.notes.texts.items()}

    def kept(self) -> list[str]:
        return sorted(path.name for path in (self.folder / "merges").glob("*"))


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path)


def test_a_merge_is_recorded_with_the_tips_as_they_were(stage: Stage) -> None:
    stage.merge()
    stage.recorder.round()
    expected = replace(RECORD, time=NOW, outcomes=NOTES, records="", key=stage.key.key_id)
    assert stage.recorded() == {FIRST: expected}
    stage.merge(SECOND)
    stage.recorder.round()
    assert stage.recorded()[SECOND].records == NOTES
    assert stage.kept() == []


def test_what_was_announced_is_known_to_the_next_process_until_its_note_stands(stage: Stage) -> None:
    """So it does not take its own merges for commits that nobody checked."""
    stage.merge()
    assert (stage.recorder.announced(), stage.started().announced()) == ({FIRST}, {FIRST})
    stage.recorder.round()
    assert stage.started().announced() == frozenset()


def test_merges_of_one_moment_are_one_push(stage: Stage) -> None:
    stage.merge(FIRST)
    stage.merge(SECOND)
    stage.recorder.round()
    assert (sorted(stage.recorded()), stage.notes.pushes, stage.recorder.written) == ([FIRST, SECOND], 1, 2)
    stage.recorder.round()
    assert stage.notes.pushes == 1


def test_what_was_not_merged_is_not_recorded(stage: Stage) -> None:
    record = stage.recorder.expect(RECORD)
    assert stage.kept() == [f"{FIRST}.json"]
    stage.recorder.round()
    assert stage.kept() == [f"{FIRST}.json"], "it is being merged now"
    stage.recorder.dropped(record)
    stage.recorder.round()
    assert (stage.recorded(), stage.kept()) == ({}, [])


def test_a_note_that_stands_is_never_written_again(stage: Stage) -> None:
    stage.notes.texts[FIRST] = "what stands"
    stage.merge()
    stage.recorder.round()
    assert (stage.notes.texts, stage.kept()) == ({FIRST: "what stands"}, [])


def test_what_the_forge_did_not_take_stays_due(stage: Stage) -> None:
    stage.merge()
    stage.notes.away = 1
    with pytest.raises(UnavailableError):
        stage.recorder.round()
    assert stage.kept() == [f"{FIRST}.json"]
    stage.recorder.round()
    assert (list(stage.recorded()), stage.kept()) == ([FIRST], [])


def test_a_process_that_ended_before_its_push_is_made_good_by_the_next(stage: Stage) -> None:
    stage.merge(FIRST)
    stage.recorder.expect(replace(RECORD, commit=SECOND))
    stage.main.commits.add(FIRST)
    next_one = stage.started()
    next_one.round()
    assert list(stage.recorded()) == [FIRST], "main has the first, and never got the second"
    assert stage.kept() == []


def test_a_merge_under_way_while_the_last_process_is_made_good_stays(stage: Stage) -> None:
    next_one = stage.started()
    record = next_one.expect(RECORD)
    next_one.round()
    assert stage.kept() == [f"{FIRST}.json"]
    next_one.merged(record)
    next_one.round()
    assert list(stage.recorded()) == [FIRST]


@pytest.mark.parametrize("on_main", [True, False])
def test_a_push_without_an_answer_is_looked_up(stage: Stage, on_main: bool) -> None:
    stage.recorder.round()
    record = stage.recorder.expect(RECORD)
    if on_main:
        stage.main.commits.add(FIRST)
    stage.recorder.unsure(record)
    stage.main.away = True
    with pytest.raises(UnavailableError):
        stage.recorder.round()
    stage.main.away = False
    stage.recorder.round()
    assert (list(stage.recorded()), stage.kept()) == ([FIRST] if on_main else [], [])


def test_a_file_that_cannot_be_read_is_left_out(stage: Stage) -> None:
    (stage.folder / "merges").mkdir()
    (stage.folder / "merges" / f"{SECOND}.json").write_text('{"commit": ')
    stage.merge()
    stage.recorder.round()
    assert list(stage.recorded()) == [FIRST]


def test_a_disk_that_refuses_lets_nothing_merge(stage: Stage) -> None:
    (stage.folder / "merges").write_text("no folder")
    with pytest.raises(InputError, match="merges cannot be announced, so nothing is merged"):
        stage.recorder.expect(RECORD)


def test_the_loop_tries_again_and_writes_what_is_left_when_it_ends(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(merge_records, "GATHER_SECONDS", 0.0)
    stage.notes.away = 3
    stopping = threading.Event()
    thread = threading.Thread(target=stage.recorder.run, args=(stopping,))
    thread.start()
    stage.merge(FIRST)
    assert stage.notes.written.wait(30), "nobody merges any more"
    stage.merge(SECOND)
    stage.recorder.stop(stopping)
    thread.join(30)
    assert (thread.is_alive(), sorted(stage.recorded())) == (False, [FIRST, SECOND])


# -- the statement ---------------------------------------------------------------------------------------------------


@pytest.fixture
def key(tmp_path: Path) -> KeyFile:
    return signing_key(tmp_path / "key", 1)


@pytest.fixture
def keys(tmp_path: Path, key: KeyFile) -> TrustedKeys:
    return trusting(tmp_path / "keys", key)


def test_a_record_reads_back_as_it_was_signed(key: KeyFile, keys: TrustedKeys) -> None:
    record = replace(RECORD, approvals=("ada", "grace"), time=NOW).anchored(NOTES, "")
    statement = record_statement(record, "http://forge/d", "gate")
    assert read_record(keys.verify(key.sign(statement))) == replace(record, key=key.key_id)


def test_evidence_of_a_chart_is_no_record(key: KeyFile, keys: TrustedKeys) -> None:
    for envelope in Signing(key).sign(artefact()).values():
        with pytest.raises(InputError, match="about something else"):
            read_record(keys.verify(envelope))


def test_a_record_is_no_evidence_of_a_chart(key: KeyFile, keys: TrustedKeys) -> None:
    """Even one about a commit whose id somebody takes for a digest."""
    record = keys.verify(key.sign(record_statement(replace(RECORD, time=NOW), "http://forge/d", "gate")))
    names = [*(rule.name for rule in POLICY.suites), "summary"]
    about = artefact()
    assessment = assess(about, POLICY, record.envelope_digest, dict.fromkeys(names, record), listing(about))
    assert not assessment.assured
    assert "summary: the evidence is about another digest" in assessment.explanation


@pytest.mark.parametrize(
    ("part", "value", "words"),
    [
        ("previous", "main", "is no commit"),
        ("author", 7, "lacks one of previous, author"),
        ("records", None, "lacks one of previous, author"),
    ],
)
def test_a_signed_statement_that_is_almost_a_record_is_refused(part: str, value: object, words: str) -> None:
    statement = record_statement(replace(RECORD, time=NOW), "http://forge/d", "gate")
    values = statement["subject"][0]["annotations"]
    values[part] = value
    with pytest.raises(InputError, match=words):
        read_record(VerifiedStatement(statement, "sha256:1", "key"))


def test_a_record_without_a_time_is_refused() -> None:
    statement = record_statement(replace(RECORD, time="yesterday"), "http://forge/d", "gate")
    with pytest.raises(InputError, match="its timeVerified is no time"):
        read_record(VerifiedStatement(statement, "sha256:1", "key"))


def test_the_references_are_beside_each_other() -> None:
    assert (OUTCOMES_REFERENCE, REFERENCE) == ("refs/notes/robotkube", "refs/notes/robotkube-gate")
