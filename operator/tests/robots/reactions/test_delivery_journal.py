"""Deliveries that outlive their process: on a real disk, which may be full, cut off in a line, or not there."""

from __future__ import annotations

import errno
import random
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from robotkube.errors import UnavailableError
from robotkube.robots.reactions.adapters.delivery_files import DeliveryFile
from robotkube.robots.reactions.core.settings import (
    MqttReactionSettings,
    PythonReactionSettings,
    WebhookReactionSettings,
)
from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
from robotkube.robots.reactions.loops.deliveries import Deliveries
from robotkube.robots.reactions.loops.delivery_journal import (
    ENTRY_SECONDS_MAX,
    JOURNAL_BYTES_MAX,
    LOG_BYTES_MAX,
    UNCLAIMED_SECONDS,
    DeliveryJournal,
    ReactionJournal,
)
from robotkube.robots.reactions.ports.deliveries import DeliverySender, EdgeDelivery, JournalEntry
from robotkube.robots.rules.core import START
from tests.stages.waiting import until

HOOK, OTHER = "hook", "other"
FILE = "deliveries.jsonl"
SECOND_NS = 1_000_000_000
NOW = 1_795_250_000 * SECOND_NS
SEEDS = range(150)
STEPS = 40


def delivery(number: int, size: int = 20) -> EdgeDelivery:
    return EdgeDelivery(f"{number:016x}-start", START, "t" * 32, b'{"text": "' + b"x" * size + b'"}')


class Disk(DeliveryFile):
    """A real file; `error` is what the next writes meet, `cut` how much of one is there nevertheless."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.error, self.opened, self.written = 0, 0, 0

    def open(self) -> Sequence[JournalEntry]:
        self.opened += 1
        self._refuse()
        return super().open()

    def write(self, added: Sequence[JournalEntry], removed: Sequence[tuple[str, str]]) -> None:
        self._refuse()
        self.written += 1
        super().write(added, removed)

    def replace(self, entries: Sequence[JournalEntry]) -> None:
        self._refuse()
        super().replace(entries)

    def _refuse(self) -> None:
        if self.error:
            raise OSError(self.error, "refused")


class Life:
    """One process: its journal is turned by hand."""

    def __init__(self, folder: Path, now: int = NOW) -> None:
        self.disk = Disk(folder)
        self.now = now
        self.seconds = 0.0
        self.box = DeadLetterBox(lambda: self.now)
        self.journal = DeliveryJournal(self.disk, self.box, lambda: self.now, lambda: self.seconds)
        self.hook = ReactionJournal(self.journal, HOOK, "webhook near host")

    def from_predecessor(self) -> list[str]:
        assert self.journal.turn()
        return [one.id for one in self.hook.from_predecessor()]

    def kill(self) -> None:
        """What the end of a process does."""
        self.disk.close()


def ids(*numbers: int) -> list[str]:
    return [delivery(number).id for number in numbers]


def test_the_next_process_finds_what_was_not_delivered_in_its_order_once(tmp_path: Path) -> None:
    life = Life(tmp_path / "a" / "b")
    assert not life.hook.settled
    assert life.from_predecessor() == []
    assert life.hook.settled
    for number in (3, 1, 2):
        life.hook.add(delivery(number))
    life.journal.turn()
    life.hook.done(delivery(1))
    life.journal.turn()
    assert life.journal.document()["kept"] == 2
    life.kill()
    second = Life(tmp_path / "a" / "b")
    assert second.journal.turn()
    assert second.hook.from_predecessor() == [delivery(3), delivery(2)], "the same to the letter"
    assert second.hook.from_predecessor() == ()
    assert second.journal.document()["replayed"] == 2
    second.kill()
    third = Life(tmp_path / "a" / "b")
    assert third.from_predecessor() == ids(3, 2), "until somebody has it"
    for number in (3, 2):
        third.hook.done(delivery(number))
    third.journal.turn()
    assert (tmp_path / "a" / "b" / FILE).read_bytes() == b"", "nothing is kept of what is over"
    third.kill()
    assert Life(tmp_path / "a" / "b").from_predecessor() == []


def test_what_is_delivered_at_once_is_never_written(tmp_path: Path) -> None:
    life = Life(tmp_path)
    life.journal.turn()
    life.hook.add(delivery(1))
    life.hook.done(delivery(1))
    life.journal.turn()
    assert (life.disk.written, life.disk.size) == (0, 0)


def test_every_history_of_kills_leaves_what_was_kept_and_nothing_else(tmp_path: Path) -> None:
    """Kills at any time, a last write that is there in part, disks that refuse: what is found was added and is not
    known to be over, and everything is found that was on the disk."""
    for seed in SEEDS:
        chance = random.Random(seed)  # noqa: S311 - not for secrets
        folder = tmp_path / str(seed)
        life = Life(folder)
        number = 0
        life.journal.turn()
        live: list[str] = []  # added and not done
        safe: set[str] = set()  # of these, what a successor must find
        over: set[str] = set()  # whose removal is written
        for _ in range(STEPS):
            what = chance.random()
            if what < 0.4:
                number += 1
                life.hook.add(delivery(number))
                live += ids(number)
            elif what < 0.6 and live:
                gone = live.pop(chance.randrange(len(live)))
                life.hook.done(EdgeDelivery(gone, START, "", b""))
                safe.discard(gone)
            elif what < 0.7:
                life.disk.error = chance.choice((0, errno.ENOSPC, errno.EIO))
            elif what < 0.9:
                if life.journal.turn():
                    safe = set(live)
                    over = {*ids(*range(1, number + 1))} - set(live)
            else:
                before = life.disk.size
                life.journal.turn()
                life.kill()
                path = folder / FILE
                if (size := path.stat().st_size) > before:
                    path.write_bytes(path.read_bytes()[: chance.randrange(before, size + 1)])
                life = Life(folder)
                left = life.from_predecessor()
                assert len(set(left)) == len(left)
                assert safe <= set(left), seed
                assert set(left) <= {*ids(*range(1, number + 1))} - over, seed
                assert left == sorted(left), seed
                live = left
                safe = set(left)
        life.kill()


def test_a_full_disk_is_said_and_counted_and_got_over(tmp_path: Path) -> None:
    life = Life(tmp_path)
    life.journal.turn()
    life.disk.error = errno.ENOSPC
    life.hook.add(delivery(1))
    life.hook.add(delivery(2))
    assert not life.journal.turn()
    assert not life.journal.turn()
    document = life.journal.document()
    assert "refused" in document["problem"]
    assert (document["kept"], document["unkept"]) == (0, 2)
    life.hook.done(delivery(1))
    life.disk.error = 0
    assert life.journal.turn()
    document = life.journal.document()
    assert (document["problem"], document["kept"], document["unkept"]) == ("", 1, 2)
    life.kill()
    assert Life(tmp_path).from_predecessor() == ids(2)


def test_no_more_waits_on_the_disk_than_is_allowed_and_the_file_is_written_anew(tmp_path: Path) -> None:
    life = Life(tmp_path)
    size = 1_000_000
    life.journal.turn()
    for number in range(12):
        life.hook.add(delivery(number, size))
    life.journal.turn()
    kept = JOURNAL_BYTES_MAX // size
    assert (life.journal.document()["kept"], life.journal.unkept) == (kept, 12 - kept)
    assert life.disk.size < LOG_BYTES_MAX
    for number in range(100, 120):
        life.hook.done(delivery(number - 100 if number < 107 else number - 1, size))
        life.hook.add(delivery(number, size))
        life.journal.turn()
        assert (tmp_path / FILE).stat().st_size <= LOG_BYTES_MAX + 2 * size
    life.kill()
    assert len(Life(tmp_path).from_predecessor()) == kept


def test_what_nobody_asks_for_and_what_is_too_old_becomes_a_dead_letter(tmp_path: Path) -> None:
    life = Life(tmp_path)
    life.journal.turn()
    life.hook.add(delivery(1))
    life.now += (ENTRY_SECONDS_MAX + 1) * SECOND_NS
    life.hook.add(delivery(2))
    ReactionJournal(life.journal, OTHER, "mqtt near events").add(delivery(3))
    life.journal.turn()
    life.kill()
    second = Life(tmp_path, life.now)
    assert second.from_predecessor() == ids(2)
    assert [letter["id"] for letter in second.box.documents()] == ids(1)
    second.seconds = UNCLAIMED_SECONDS + 1
    second.journal.turn()
    assert [(letter["reaction"], letter["id"]) for letter in second.box.documents()][1:] == [
        ("mqtt near events", delivery(3).id)
    ]
    second.journal.turn()
    second.kill()
    assert Life(tmp_path, life.now).from_predecessor() == ids(2)


def test_a_folder_that_another_process_has_is_refused(tmp_path: Path) -> None:
    first, second = Life(tmp_path), Life(tmp_path)
    assert first.journal.turn()
    assert not second.journal.turn()
    assert "another process keeps its deliveries there" in second.journal.problem
    assert second.hook.settled, "nobody waits for it"
    first.kill()
    assert second.journal.turn()
    assert second.journal.problem == ""
    second.kill()


def test_a_folder_that_cannot_be_is_named_and_tried_again(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    life = Life(tmp_path / "file" / "folder")
    assert not life.journal.turn()
    assert "file" in life.journal.problem
    life.hook.add(delivery(1))
    (tmp_path / "file").unlink()
    assert life.journal.turn()
    assert life.journal.document()["kept"] == 1
    life.kill()


def test_reactions_are_told_apart_by_their_receivers() -> None:
    hooks = [
        WebhookReactionSettings("near", f"http://host/{path}", retry_seconds=s)
        for path, s in (("a", 1), ("a", 2), ("b", 1))
    ]
    assert hooks[0].name == hooks[2].name
    assert hooks[0].key == hooks[1].key
    assert hooks[0].key != hooks[2].key
    keys = {hooks[0].key, hooks[2].key, MqttReactionSettings("near", "a").key, MqttReactionSettings("far", "a").key}
    keys |= {PythonReactionSettings("near", "a", {"b": 1}).key, PythonReactionSettings("near", "a", {"b": 2}).key}
    assert len(keys) == 6


class Receiver:
    """Port Sender. `away`: it does not answer."""

    def __init__(self, away: bool = False) -> None:
        self.away = away
        self.sent = list[str]()

    def probe(self) -> None: ...

    def send(self, delivery: EdgeDelivery) -> None:
        if self.away:
            raise UnavailableError("away")
        self.sent.append(delivery.id)

    def close(self) -> None: ...


@pytest.fixture
def process(tmp_path: Path) -> Iterator[Callable[[DeliverySender], tuple[DeliveryJournal, Deliveries, DeadLetterBox]]]:
    journals: list[DeliveryJournal] = []

    def begin(sender: DeliverySender) -> tuple[DeliveryJournal, Deliveries, DeadLetterBox]:
        box = DeadLetterBox(time.time_ns)
        journals.append(DeliveryJournal(DeliveryFile(tmp_path), box, time.time_ns, time.monotonic))
        journals[-1].start()
        deliveries = Deliveries("told", sender, 60.0, box, time.monotonic, ReactionJournal(journals[-1], HOOK, "told"))
        deliveries.start()
        return journals[-1], deliveries, box

    yield begin
    for journal in journals:
        journal.stop(5.0)


def test_what_is_not_delivered_when_the_process_ends_is_left_to_the_next_one(
    process: Callable[[DeliverySender], tuple[DeliveryJournal, Deliveries, DeadLetterBox]],
) -> None:
    journal, deliveries, box = process(Receiver(away=True))
    for number in range(3):
        deliveries.react(delivery(number))
    until(lambda: journal.document()["kept"] == 3)
    journal.end()
    assert not deliveries.stop(0.3)
    assert box.documents() == []
    assert journal.stop(5.0)
    there = Receiver()
    journal, deliveries, box = process(there)
    deliveries.react(delivery(7))
    until(lambda: deliveries.counts()["delivered"] == 4)
    assert there.sent == ids(0, 1, 2, 7), "what was left comes first"
    until(lambda: journal.document()["kept"] == 0)


def test_what_a_reaction_that_is_left_out_of_the_settings_has_not_delivered_is_a_dead_letter(
    process: Callable[[DeliverySender], tuple[DeliveryJournal, Deliveries, DeadLetterBox]],
) -> None:
    journal, deliveries, box = process(Receiver(away=True))
    deliveries.react(delivery(1))
    until(lambda: journal.document()["kept"] == 1)
    assert not deliveries.stop(0.3)
    until(lambda: [letter["id"] for letter in box.documents()] == ids(1))
    until(lambda: journal.document()["kept"] == 0)


def test_who_reacts_does_not_wait_for_a_disk_that_hangs(tmp_path: Path) -> None:
    life = Life(tmp_path)
    hanging = threading.Event()
    over = threading.Event()
    write = life.disk.write

    def hang(added: Sequence[JournalEntry], removed: Sequence[tuple[str, str]]) -> None:
        hanging.set()
        assert over.wait(30)
        write(added, removed)

    life.disk.write = hang  # type: ignore[method-assign]
    life.journal.start()
    life.hook.wait(5.0)
    life.hook.add(delivery(0))
    assert hanging.wait(30)
    assert life.journal.document()["kept"] == 0, "a kill would lose what is being written"
    for number in range(1, 200):
        life.hook.add(delivery(number))
        life.hook.done(delivery(number - 1))
    assert life.disk.written == 0, "the disk has not answered once by then"
    over.set()
    until(lambda: life.journal.document()["kept"] == 1)
    assert life.journal.stop(5.0)
    assert Life(tmp_path).from_predecessor() == ids(199)
