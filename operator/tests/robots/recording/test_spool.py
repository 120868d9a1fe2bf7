"""Files of the spool: what was put comes back, and what is damaged is said, never brought in, and stops nobody."""

from __future__ import annotations

import errno
import itertools
import os
import random
from pathlib import Path

import pytest

from robotkube.errors import DocumentError
from robotkube.robots.recording.adapters.bson_spool import BsonSpool
from robotkube.robots.recording.core.documents import RECORDINGS, SAMPLES, Write, messages_of

CASES, SEED = 1000, 8
UNREADABLE = "/proc/self/mem"  # the first page of a process is never mapped: reading it is an I/O error
BEGIN = 1_795_250_000_000_000_000
WRITES = [
    Write(RECORDINGS, "r", {"topics": {"/a": {"type": "t"}}, "ended": None}, size=1000),
    Write(RECORDINGS, "r", {"topics./b": {"type": "t"}}, update=True, size=200, add={"volumes": "n/c"}),
    *(
        Write(
            SAMPLES,
            f"r/a/{second}",
            {"recording": "r", "topic": "/a", "samples": [{"stamp": BEGIN + second, "data": b"some" * 9}]},
            size=100,
        )
        for second in range(9)
    ),
]


@pytest.fixture
def spool(tmp_path: Path) -> BsonSpool:
    return BsonSpool(tmp_path, "cloud-0/r", itertools.count().__next__)


def test_what_was_put_comes_back(spool: BsonSpool) -> None:
    assert spool.read(spool.put(WRITES)) == WRITES


def test_a_damaged_file_is_named_or_its_writes_can_be_brought_in(spool: BsonSpool, tmp_path: Path) -> None:
    path = tmp_path / "spool" / spool.put(WRITES)
    whole = path.read_bytes()
    moments = random.Random(SEED)  # noqa: S311 - not for secrets
    named = 0
    for _ in range(CASES):
        damaged = bytearray(whole)
        for _ in range(moments.randint(1, 4)):
            damaged[moments.randrange(len(damaged))] = moments.randrange(256)
        path.write_bytes(damaged)
        try:
            for write in spool.read(path.name):
                topic, stamps = messages_of(write)
                assert not stamps or write.document["recording"] + topic
        except DocumentError as error:
            named += str(path) in str(error)
    assert named > CASES / 2


def test_a_file_that_cannot_be_read_is_named_while_its_volume_can(spool: BsonSpool, tmp_path: Path) -> None:
    name = spool.put(WRITES)
    (tmp_path / "spool" / "0.bson").symlink_to(UNREADABLE)
    with pytest.raises(DocumentError, match=r"0\.bson: cannot be read \(Input/output error\), though the volume works"):
        spool.read("0.bson")
    assert [batch.name for batch in spool.batches()] == ["0.bson", name]
    assert sorted(path.suffix for path in (tmp_path / "spool").iterdir()) == [".bson", ".bson"]


def test_a_volume_that_fails_altogether_is_not_blamed_on_the_file(tmp_path: Path) -> None:
    spool = BsonSpool(tmp_path, "too long a name for a file" * 10, itertools.count().__next__)
    (tmp_path / "spool").mkdir()
    (tmp_path / "spool" / "0.bson").symlink_to(UNREADABLE)
    with pytest.raises(OSError, match="Input/output error"):
        spool.read("0.bson")


def test_a_batch_that_is_given_up_is_whole_or_replaced(
    spool: BsonSpool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = spool.put(WRITES)
    few = WRITES[:1]

    def fail(descriptor: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", fail)
        with pytest.raises(OSError, match="Input/output error"):
            spool.give_up(name, few)
    assert spool.read(name) == WRITES
    spool.give_up(name, few)
    [batch] = spool.batches()
    assert batch.given_up
    assert spool.read(batch.name) == few
    assert [path.name for path in (tmp_path / "spool").iterdir()] == [batch.name]
    spool.give_up(name, few)
    assert spool.batches() == [batch], "what another recorder has brought in is not made again"
