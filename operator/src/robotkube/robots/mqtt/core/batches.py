"""Batches of serialised messages as they travel over MQTT, and the record of those that a receiver has seen.

    `RKF1` | session u64 | sequence u64 | count u32 | count x (length u32 | message)          all little endian

One batch carries the messages of one drain of a topic, which share its cost. `session` is drawn when the sender's
process starts, `sequence` counts the batches of a topic within a session from 0 without gaps.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

from robotkube.errors import InputError

MAGIC = b"RKF1"
CONTENT_TYPE = "application/x-robotkube-frames"
MESSAGES_MAX = 20_000  # of a batch: what a sender gathers in one turn, and a receiver decodes at once
SESSIONS_MAX = 8
MISSING_MAX = 10_000

_HEAD = struct.Struct("<4sQQI")
_LENGTH = struct.Struct("<I")


class BatchError(InputError):
    """Bytes that are no batch; the sender has to change."""


@dataclass(frozen=True)
class MessageBatch:
    """A batch: its place in the sender's sequence, and serialised messages in their order."""

    session: int
    sequence: int
    messages: tuple[bytes, ...]


def encode_batch(session: int, sequence: int, messages: Sequence[bytes]) -> bytes:
    """The bytes of a batch."""
    parts = [_HEAD.pack(MAGIC, session, sequence, len(messages))]
    for message in messages:
        parts.append(_LENGTH.pack(len(message)))
        parts.append(message)
    return b"".join(parts)


def decode_batch(data: bytes) -> MessageBatch:
    """The batch in `data`; BatchError says what is wrong with it and where."""
    if len(data) < _HEAD.size:
        raise BatchError(f"a batch of {len(data)} bytes is shorter than its head of {_HEAD.size} bytes")
    magic, session, sequence, count = _HEAD.unpack_from(data)
    if magic != MAGIC:
        raise BatchError(f"the batch begins with {magic!r} instead of {MAGIC!r}; the sender speaks another format")
    if count > MESSAGES_MAX:
        raise BatchError(f"a batch of {count} messages; send at most {MESSAGES_MAX} in one")
    messages = []
    place = _HEAD.size
    size = len(data)
    for number in range(count):
        if place + 4 > size:
            raise BatchError(f"the batch ends at byte {size}, before message {number + 1} of {count}")
        end = place + 4 + _LENGTH.unpack_from(data, place)[0]
        if end > size:
            raise BatchError(f"message {number + 1} of {count} ends at byte {end} of a batch of {size} bytes")
        messages.append(data[place + 4 : end])
        place = end
    if place != size:
        raise BatchError(f"{size - place} bytes follow the last of {count} messages")
    return MessageBatch(session, sequence, tuple(messages))


class SeenBatches:
    """A record of the batches of one topic that have arrived. It holds the last SESSIONS_MAX sessions, and per session
    the highest sequence and at most MISSING_MAX numbers below it that have not come (yet)."""

    def __init__(self) -> None:
        self.duplicates = 0
        self._sessions: OrderedDict[int, tuple[int, set[int]]] = OrderedDict()

    def fresh(self, session: int, sequence: int) -> bool:
        """Record a batch; True when it is new."""
        highest, missing = self._sessions.get(session, (sequence - 1, set()))
        if sequence > highest:
            if sequence > highest + 1:
                missing.update(range(max(highest + 1, sequence - MISSING_MAX), sequence))
                if len(missing) > MISSING_MAX:
                    missing.difference_update(sorted(missing)[:-MISSING_MAX])
            self._sessions[session] = (sequence, missing)
            self._sessions.move_to_end(session)
            if len(self._sessions) > SESSIONS_MAX:
                self._sessions.popitem(last=False)
            return True
        if sequence in missing:
            missing.discard(sequence)
            return True
        self.duplicates += 1
        return False

    @property
    def missing(self) -> int:
        """The number of batches that were sent, as later ones prove, and have not come."""
        return sum(len(missing) for _, missing in self._sessions.values())
