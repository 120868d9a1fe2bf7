"""A bag played on a shared clock: the grid of stamps and the ledger that proves what was published.

A bag's times are offsets from the start of the run in ns. A message is published at `start + offset` and carries
exactly that stamp, so the stamp identifies it everywhere. The ledger of a topic has one JSON line per message.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.patterns import NAME, PLAYER_RUN
from robotkube.foundation.documents.core.reader import Reader

LATE_NS = 1_000_000_000
"""A message that is published so long after its time, or longer, is late."""
NANOSECONDS = 1_000_000_000
STAMP_SECONDS_END = 1 << 31
"""The first second since 1970 that a header's stamp cannot say."""

_LITTLE_STAMP = struct.Struct("<iI")
_BIG_STAMP = struct.Struct(">iI")
_STAMP_BEGIN = 4
_STAMP_END = 12
_PATH = re.compile(r"/.+")
_START = re.compile(r"[0-9]{1,19}")
_LAPS = re.compile(r"[1-9][0-9]{0,3}")
_END_LINE = re.compile(r'\{"end": true, "count": ([0-9]+)\}')
_LINE = re.compile(r'\{"sequence": ([0-9]+), "stamp": ([0-9]+), "sha256": "([0-9a-f]{64})"\}')


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag: its name, type and QoS profile, as the bag states them."""

    name: str
    type: str
    reliability: str
    durability: str
    depth: int

    @property
    def latched(self) -> bool:
        """Return whether its last message waits for late subscribers."""
        return self.durability == "transient_local"


@dataclass(frozen=True)
class PlayerSettings:
    """The settings of a player (`config.yaml`): its agent, and the folders of the bag and of the ledgers."""

    agent: str
    bag: str
    ledger: str


@dataclass(frozen=True)
class PlaybackRun:
    """A run that ConfigMap `simulation` orders: play from `start` (ns since 1970), under the name `id`.

    `laps`: how often the bag is played, a lap each `lap` ns. More than one is driving for its own sake: no ledger is
    kept, and a player that comes back joins the lap that is due.
    """

    id: str
    start: int
    laps: int = 1
    lap: int = 0

    def current_lap(self, now: int) -> int:
        """The number of the lap that is due at `now` (ns since 1970), from 0; before the start 0."""
        return max(0, (now - self.start) // self.lap) if self.lap else 0


def read_player_settings(document: Mapping[str, Any], where: str) -> PlayerSettings:
    """The settings of a player in a document; DocumentError names `where` and every problem."""
    reader = Reader(where)
    values = reader.mapping(document, "", ["agent", "bag", "ledger"])
    settings = PlayerSettings(
        agent=reader.text(values.get("agent"), "agent", NAME),
        bag=reader.text(values.get("bag"), "bag", _PATH),
        ledger=reader.text(values.get("ledger"), "ledger", _PATH),
    )
    reader.finish()
    return settings


def read_run(data: Mapping[str, str] | None, where: str) -> PlaybackRun | None:
    """The run that ConfigMap `simulation` orders; None without ConfigMap or without key `run`. DocumentError names key
    and fix."""
    if not data or "run" not in data:
        return None
    run = data["run"]
    start = data.get("start", "")
    problems = [] if PLAYER_RUN.fullmatch(run) else [f"run: {run!r} must match {PLAYER_RUN.pattern}"]
    if not _START.fullmatch(start):
        problems.append(f"start: {start!r} must be a time in ns since 1970, as digits")
    laps = data.get("laps", "1")
    lap = data.get("lap", "0")
    if not _LAPS.fullmatch(laps):
        problems.append(f"laps: {laps!r} must be how often the bag is played, from 1 to 9999")
    if not _START.fullmatch(lap):
        problems.append(f"lap: {lap!r} must be the time from one lap to the next in ns, as digits")
    elif laps != "1" and int(lap) < NANOSECONDS:
        problems.append(f"lap: {lap!r} must be at least {NANOSECONDS} ns when there are several laps")
    if problems:
        raise DocumentError(where, problems)
    return PlaybackRun(run, int(start), int(laps), int(lap))


def restamped(data: bytes, stamp: int) -> bytes:
    """A serialised message that begins with std_msgs/Header, now with `stamp` (ns). InputError: the message is too
    short, or the stamp is beyond what a header can say."""
    if len(data) < _STAMP_END:
        raise InputError(f"a message of {len(data)} bytes does not begin with std_msgs/Header")
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    if not -STAMP_SECONDS_END <= seconds < STAMP_SECONDS_END:
        raise InputError(
            f"the start of the run and a time of the bag make {seconds} s since 1970, more than a stamp can say: "
            "times of a bag that is played count from the start of the run, not from 1970"
        )
    time = (_LITTLE_STAMP if data[1] & 1 else _BIG_STAMP).pack(seconds, nanoseconds)
    return b"".join((data[:_STAMP_BEGIN], time, data[_STAMP_END:]))


def ledger_name(topic: str) -> str:
    """File name of a topic's ledger: every / becomes __, also the first."""
    return f"{topic.replace('/', '__')}.jsonl"


def ledger_line(sequence: int, stamp: int, sha256: str) -> str:
    """The line of one message in a ledger."""
    return f'{{"sequence": {sequence}, "stamp": {stamp}, "sha256": "{sha256}"}}\n'


def ledger_end(count: int) -> str:
    """The last line of a ledger whose topic was played to its end."""
    return f'{{"end": true, "count": {count}}}\n'


@dataclass(frozen=True)
class LedgerState:
    """The state of a ledger that is already there. `messages`: number of published ones; `next_sequence`: the first
    sequence number after them; `ended`: whether its topic was played to its end; `whole_bytes`: length of its whole
    lines (a torn last line is cut off)."""

    messages: int = 0
    next_sequence: int = 0
    ended: bool = False
    whole_bytes: int = 0


def read_ledger(data: bytes) -> LedgerState:
    """The state of a ledger by its bytes; lines after a torn or foreign one do not count."""
    messages = next_sequence = whole_bytes = 0
    for raw in data.splitlines(keepends=True):
        line = raw.decode("ascii", errors="replace")
        if not line.endswith("\n"):
            break
        if _END_LINE.fullmatch(line.rstrip("\n")):
            return LedgerState(messages, next_sequence, True, whole_bytes + len(raw))
        match = _LINE.fullmatch(line.rstrip("\n"))
        if match is None:
            break
        messages += 1
        next_sequence = int(match[1]) + 1
        whole_bytes += len(raw)
    return LedgerState(messages, next_sequence, False, whole_bytes)
