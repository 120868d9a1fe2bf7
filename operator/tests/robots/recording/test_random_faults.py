"""A recording against its sources' ledgers under random faults: what is missing is explained, what is there is right.

Database away, volume away, disk full, kill -9 at any write: everything in memory and in one thread, so that a seed
gives the same history again.
"""

from __future__ import annotations

import hashlib
import random
import threading
from collections.abc import Iterable, Mapping

import pytest

from robotkube.robots.recording.core.audits import KILLED, add_up
from robotkube.robots.recording.core.documents import AUDITS, RECORDINGS, Write
from robotkube.robots.recording.core.ledgers import LedgerLine
from robotkube.robots.recording.core.manifests import is_journals
from robotkube.robots.recording.core.verification import TopicExamination, examine
from robotkube.robots.recording.loops.destinations import RecorderPlace, RecordingBounds
from robotkube.robots.recording.loops.journal import Journal
from robotkube.robots.recording.loops.reading import stored_messages, wrong_segments
from robotkube.robots.recording.loops.recorder import Recorder
from robotkube.testing.recordings import Killed, RecordingDatabase, RecordingVolume
from tests.stages.examples import EXAMPLES
from tests.stages.recording.seals import examined

RECORDING, VOLUME = "task-1", "cloud-0/recordings"
TOPICS = {"/pose": ("document", 10, 30), "/cloud": ("segment", 100, 900)}
MIXED = {"/pose": ("document", 10, 30), "/picture": ("either", 20, 200)}
"""Of pictures every other one is too large for a document."""
BOUNDS = RecordingBounds(queue_bytes=12_000, waiting_bytes=8_000, spool_bytes=30_000)
STEPS, MS = 60, 1_000_000
BEGIN = 1_795_250_000_000_000_000
FOUND = (575, 1156, 1221, 1474, 1560, 1691, 1928, 1993, 2029, 2082, 2213, 2839)
"""Seeds that have found something: a recorder that took itself for its predecessor, and one whose predecessor had
stored without an audit after another one that was killed."""
ENOUGH = max(EXAMPLES, 20)  # that the faults reach every place
SEEDS = (*range(ENOUGH), *FOUND)
SEEDS_THOROUGH = range(200, 3000)


class PromptJournal(Journal):
    """One whose thread is through with everything before whoever adds it can do anything else."""

    turning = False

    def add(self, writes: Iterable[Write], durable: bool = False) -> None:
        super().add(writes, durable)
        if not self.turning:
            self.turning = True
            self.turn()
            self.turning = False


class InterruptedJournal(Journal):
    """One to which another thread comes just when a recording's document is on its way."""

    other: threading.Thread

    def add(self, writes: Iterable[Write], durable: bool = False) -> None:
        writes = list(writes)
        if any(write.collection == RECORDINGS and not write.update for write in writes):
            self.other.start()
            self.other.join(0.2)
        super().add(writes, durable)


class History:
    """Processes that record one after another, and the world they do it in."""

    def __init__(
        self, seed: int, topics: Mapping[str, tuple[str, int, int]] = TOPICS, journal: type[Journal] = Journal
    ) -> None:
        self.random = random.Random(seed)  # noqa: S311 - not for secrets
        self.topics = topics
        self.kind_of_journal = journal
        self.of_manifests = random.Random(seed)  # noqa: S311 - one of its own: seeds from before go on as they did
        self.database = RecordingDatabase(self.kill_now_and_then, self.kill_at_a_manifest)
        self.volume = RecordingVolume(self.kill_now_and_then, self.kill_at_a_manifest)
        self.ledgers: dict[str, list[LedgerLine]] = {topic: [] for topic in topics}
        self.lives: dict[str, list[int]] = {topic: [] for topic in topics}
        self.offered = dict.fromkeys(topics, 0)
        self.kills = 0
        self.now = 0
        self.deadly = False
        self.begin()

    def clock_ns(self) -> int:
        """Later than every stamp."""
        self.now += 1
        return (
            max(line.stamp for lines in self.ledgers.values() for line in [LedgerLine(0, BEGIN, ""), *lines[-1:]])
            + self.now
        )

    def kill_now_and_then(self) -> None:
        if self.deadly and self.random.random() < 0.004:
            raise Killed

    def kill_at_a_manifest(self) -> None:
        if self.deadly and self.of_manifests.random() < 0.02:
            raise Killed

    def begin(self) -> None:
        """A new process."""
        self.volume.forget_writers()
        place = RecorderPlace(VOLUME, lambda: self.database, self._claim, self.clock_ns, lambda: self.now / 1000)
        self.journal = self.kind_of_journal(RECORDING, place, BOUNDS)
        document = {"rule": "r", "trace": "", "provenance": {}, "topics": {}}
        self.recorder = Recorder(RECORDING, document, self.journal, place, bounds=BOUNDS)
        self.life = self.recorder.life

    def _claim(self) -> RecordingVolume:
        self.volume.require()
        return self.volume

    def publish(self) -> None:
        """Up to 100 ms of messages; a few come twice."""
        for topic, (storage, period, _) in self.topics.items():
            for _ in range(self.random.randrange(100 // period + 1)):
                place = ("segment", "document")[self.random.randrange(2)] if storage == "either" else storage
                self.say(topic, place)

    def say(self, topic: str, storage: str) -> None:
        """One message; now and then twice."""
        _, period, size = self.topics[topic]
        number = len(self.ledgers[topic])
        data = number.to_bytes(4, "little") * (size // 4)
        stamp = BEGIN + number * period * MS
        self.ledgers[topic].append(LedgerLine(number, stamp, hashlib.sha256(data).hexdigest()))
        self.lives[topic].append(self.life)
        for _ in range(1 + (self.random.random() < 0.05)):
            self.offered[topic] += 1
            self.recorder.offer(topic, "t", storage, stamp, stamp, data)

    def step(self) -> None:
        """Something happens."""
        self.now += 300
        what = self.random.random()
        if what < 0.05:
            self.database.away = not self.database.away
        elif what < 0.08:
            self.volume.away = not self.volume.away
        elif what < 0.12:
            self.volume.bytes_max = self.random.choice((10_000, 30_000, 1 << 60))
        elif what < 0.13:
            raise Killed
        elif what < 0.5:
            self.publish()
        elif what < 0.75:
            self.recorder.turn()
        else:
            self.journal.turn()

    def run(self) -> None:
        """All steps, kills and restarts included, and at last a process that ends as it should."""
        self.deadly = True
        for _ in range(STEPS):
            try:
                self.step()
            except Killed:
                self.kills += 1
                self.begin()
        self.deadly = self.database.away = self.volume.away = False
        self.volume.bytes_max = 1 << 60
        self.finish()

    def finish(self) -> None:
        """The end of a process that nothing is in the way of."""
        for _ in range(3):
            self.now += 10_000
            self.journal.turn()
            self.recorder.turn()
        self.recorder.finish()
        self.journal.finish((self.now + 100_000) / 1000)

    def examined(self) -> list[TopicExamination]:
        stored = stored_messages(self.database, self.volume, RECORDING)
        audits = add_up(self.database.audits(RECORDING))
        audited = {(audit["topic"], audit["life"]) for audit in self.database.audits(RECORDING)}
        # a process that was killed before it could leave anything anywhere has no audit, and nobody can know of it
        ledgers = {
            topic: [line for line, life in zip(lines, self.lives[topic], strict=True) if (topic, life) in audited]
            for topic, lines in self.ledgers.items()
        }
        return examine(stored, audits, ledgers, (0, 2**63 - 1))


def assert_explained(history: History) -> None:
    for topic in history.examined():
        assert topic.comparison is not None
        problems = (
            topic.duplicates,
            topic.mismatches,
            topic.unreadable,
            topic.comparison.mismatches,
            topic.unexplained,
        )
        assert problems == (0, (), (), (), 0), topic
        if not history.kills and topic.audit is not None:
            assert topic.audit.exact
            assert topic.audit.received == history.offered[topic.topic]
            assert topic.audit.received - topic.audit.dropped - topic.audit.duplicates == topic.stored
    assert not wrong_segments(history.database, history.volume, RECORDING)
    assert all(audit["closed"] for audit in history.database.audits(RECORDING))
    assert_sealed(history)


def assert_sealed(history: History) -> None:
    """What is there is what its writers sealed; what is not, the journal gave up, and says so."""
    if RECORDING not in history.database.collections.get(RECORDINGS, {}):
        return
    seals = examined(history.database, history.volume, RECORDING)
    assert (seals.changed, seals.unknown) == ([], [])
    given_up = {audit["topic"] for audit in history.database.audits(RECORDING) if is_journals(audit)}
    assert {topic for _, topic in seals.missing} <= given_up
    others = [problem for problem in seals.problems if not problem.endswith("messages of it")]
    assert others == []
    assert seals.reservations == []


def check(seed: int, topics: Mapping[str, tuple[str, int, int]] = TOPICS) -> History:
    history = History(seed, topics)
    history.run()
    assert_explained(history)
    return history


def test_what_is_missing_is_explained_under_random_faults() -> None:
    histories = [check(seed) for seed in SEEDS]
    dropped = [gap.where for h in histories for one in h.examined() if one.audit for gap in one.audit.gaps]
    assert {"queue", "spool", "memory", "recorder"} <= set(dropped), "the faults reached every place that can drop"
    assert sum(history.kills == 0 for history in histories) > len(SEEDS) // 5
    assert sum(history.kills > 0 for history in histories) > len(SEEDS) // 5


def test_what_is_missing_is_explained_where_messages_go_two_ways() -> None:
    """Small ones overtake large ones while the volume refuses, and large ones are on the disk before small ones."""
    assert sum(check(seed, MIXED).kills > 0 for seed in range(ENOUGH)) > ENOUGH // 6


def test_a_kill_hides_no_large_message_that_smaller_ones_have_overtaken() -> None:
    """The volume is full for the large ones; the small ones behind them are in the database when the process ends."""
    history = History(1, {"/picture": ("document", 20, 200)})
    history.journal.turn()
    for storage in ("document", "document"):
        history.say("/picture", storage)
    history.recorder.turn()
    history.journal.turn()
    history.volume.bytes_max = 0
    for _ in range(3):
        for storage in ("segment", "document"):
            history.say("/picture", storage)
        history.now += 6_000  # the audit is told again, with all that came
        history.recorder.turn()
        history.journal.turn()
    assert len(list(history.database.known(RECORDING))) == 5
    history.begin()
    history.volume.bytes_max = 1 << 60
    history.finish()
    [picture] = history.examined()
    assert picture.audit is not None
    assert (picture.stored, picture.unexplained) == (5, 0)
    lost = [BEGIN + number * 20 * MS for number in (2, 4, 6)]
    assert [one.stamp for one in picture.comparison.lost] == lost
    assert all(any(gap.why == KILLED and gap.covers(stamp) for gap in picture.audit.gaps) for stamp in lost)
    assert min(gap.first for gap in picture.audit.gaps) == lost[0], "what is stored before is not doubted"


@pytest.mark.thorough
def test_what_is_missing_is_explained_under_many_more_random_faults() -> None:
    for seed in SEEDS_THOROUGH:
        check(seed)
        check(seed, MIXED)


def test_the_first_word_of_a_topic_goes_to_the_spool_and_what_follows_waits_in_memory() -> None:
    history = History(1, journal=PromptJournal)
    history.journal.turn()
    history.say("/pose", "document")
    history.recorder.turn()
    history.database.away = True
    for _ in range(3):
        history.now += 1_000
        history.say("/pose", "document")
        history.recorder.turn()
    assert history.journal.counts.spooled == 0, "the database knows of the topic"
    waiting = history.journal.waiting
    assert waiting > 0
    history.now += 1_000
    history.say("/cloud", "segment")
    history.recorder.turn()
    assert history.journal.counts.spooled > waiting


def test_what_is_updated_while_the_document_is_made_is_not_lost() -> None:
    history = History(1, journal=InterruptedJournal)
    other = threading.Thread(target=history.recorder.update, args=({"causes": ["late"]},))
    history.journal.other = other  # type: ignore[attr-defined]
    history.journal.turn()
    history.say("/pose", "document")
    history.recorder.turn()
    other.join()
    history.journal.turn()
    assert history.database.collections[RECORDINGS][RECORDING]["causes"] == ["late"]


def test_nothing_empty_is_created() -> None:
    history = History(0)
    history.run = lambda: None  # type: ignore[method-assign]
    history.journal.turn()
    history.recorder.turn()
    history.recorder.finish()
    history.journal.finish(1.0)
    assert not history.database.collections
    assert AUDITS not in history.database.collections
    assert not history.volume.files
    assert not history.volume.batches
