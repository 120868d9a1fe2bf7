"""Files of the spool: what was put comes back, and what is damaged is said, never brought in, and stops nobody."""

from __future__ import annotations

import itertools
import random
from pathlib import Path

import pytest

from robotkube.adapters.spool_bson import BsonSpool
from robotkube.domain.errors import DocumentError
from robotkube.domain.recordings import RECORDINGS, SAMPLES, Write, messages_of

CASES, SEED = 1000, 8
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
    whole, moments, named = path.read_bytes(), random.Random(SEED), 0  # noqa: S311 - not for secrets
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
