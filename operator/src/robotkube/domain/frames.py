"""The frame in which serialised messages travel over MQTT, and how a receiver knows the ones it has seen.

    `RKF1` | session u64 | sequence u64 | count u32 | count x (length u32 | message)          all little endian

One frame carries what one drain of a topic brought, so that the cost per frame is shared. `session` is drawn when the
sender's process starts, `sequence` counts the frames of a topic within a session from 0 without gaps.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

from robotkube.domain.errors import InputError

MAGIC = b"RKF1"
CONTENT_TYPE = "application/x-robotkube-frames"
MESSAGES_MAX = 20_000  # of a frame: what a sender gathers in one turn, and a receiver takes at once
SESSIONS_MAX = 8
MISSING_MAX = 10_000

_HEAD = struct.Struct("<4sQQI")
_LENGTH = struct.Struct("<I")


class FrameError(InputError):
    """Bytes that are no frame; the sender has to change."""


@dataclass(frozen=True)
class Frame:
    """One frame's content; `messages` are serialised messages in their order."""

    session: int
    sequence: int
    messages: tuple[bytes, ...]


def encode_frame(session: int, sequence: int, messages: Sequence[bytes]) -> bytes:
    """The frame's bytes."""
    parts = [_HEAD.pack(MAGIC, session, sequence, len(messages))]
    for message in messages:
        parts.append(_LENGTH.pack(len(message)))
        parts.append(message)
    return b"".join(parts)


def decode_frame(data: bytes) -> Frame:
    """The frame in `data`; FrameError says what is wrong with it and where."""
    if len(data) < _HEAD.size:
        raise FrameError(f"a frame of {len(data)} bytes is shorter than its head of {_HEAD.size} bytes")
    magic, session, sequence, count = _HEAD.unpack_from(data)
    if magic != MAGIC:
        raise FrameError(f"the frame begins with {magic!r} instead of {MAGIC!r}; the sender speaks another format")
    if count > MESSAGES_MAX:
        raise FrameError(f"a frame of {count} messages; send at most {MESSAGES_MAX} in one")
    messages, place, size = [], _HEAD.size, len(data)
    for number in range(count):
        if place + 4 > size:
            raise FrameError(f"the frame ends at byte {size}, before message {number + 1} of {count}")
        end = place + 4 + _LENGTH.unpack_from(data, place)[0]
        if end > size:
            raise FrameError(f"message {number + 1} of {count} ends at byte {end} of a frame of {size} bytes")
        messages.append(data[place + 4 : end])
        place = end
    if place != size:
        raise FrameError(f"{size - place} bytes follow the last of {count} messages")
    return Frame(session, sequence, tuple(messages))


class SeenFrames:
    """Which frames of one topic have arrived. Remembers the last SESSIONS_MAX sessions, and per session the highest
    sequence and at most MISSING_MAX numbers below it that have not come (yet)."""

    def __init__(self) -> None:
        self.duplicates = 0
        self._sessions: OrderedDict[int, tuple[int, set[int]]] = OrderedDict()

    def fresh(self, session: int, sequence: int) -> bool:
        """Whether this frame is new; asking makes it seen."""
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
        """Frames that were sent, as later ones prove, and have not come."""
        return sum(len(missing) for _, missing in self._sessions.values())
