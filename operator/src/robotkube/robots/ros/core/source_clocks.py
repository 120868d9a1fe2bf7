"""The clock of a source: what its stamps say of time, for everybody who goes by them.

A source is a topic. Its clock knows how far its stamps have come, the watermark, and says of every message whether it
is the next one, is out of order, or is not to be believed. The ring buffer asks it, and passes on what it said, so
that rules decide on no stamp that the buffer refuses. docs/explanation/buffer-and-time.md has the rules.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

NEXT, BETWEEN, LATE, AHEAD, JUMPED = "next", "between", "late", "ahead", "jumped"
"""The verdicts on a message: newer than all before; not newer, but within the window; too old; too new to be believed;
the second of its kind in a row, so that the source's time has jumped there."""

SILENT, DISORDERED, BEHIND, STEADY = "silent", "disordered", "behind", "steady"
"""The states of a source, with AHEAD and JUMPED."""

JUMP_RESTART, JUMP_KEEP = "restart", "keep"

FOREVER_NS = 1 << 80
OUTLIERS_MAX = 3
"""Messages in a row, all far ahead or all far behind, that are a jump wherever they are."""
BEHIND_COUNT = 10
BEHIND_NS = 1_000_000_000
"""Messages in a row, and the least time they span, all behind the newest: time went back by less than the window."""
DISORDER_NS_MAX = 2_000_000_000
"""The most that rules wait for messages that come out of order."""
CALM_NS = 30_000_000_000
"""A source that has kept its order for so long is not waited for any more; what it was longer ago does not count."""
OFFSET_NS = 1_000_000_000
"""A source whose newest stamp and its time of reception are farther apart is ahead, or behind."""
JUMPED_NS = 10_000_000_000
"""How long a jump is the state of its source."""
_MARGIN_SHARE = 4


class Sample(NamedTuple):
    """One message: when it was measured (header stamp, else reception) and received, ns since 1970, and its CDR bytes.

    A named tuple, because it costs a quarter of a frozen dataclass and the garbage collector lets go of it.
    """

    stamp: int
    received: int
    data: bytes


@dataclass(slots=True)
class _Disorder:
    """The disorder of a source in the last while: `offset_ns` is what its fastest messages take, its clock's error
    included, `late_ns` how much longer those that came out of order took. `next_*`: the same since `since`."""

    since: int
    offset_ns: int
    next_offset_ns: int
    late_ns: int = 0
    next_late_ns: int = 0
    last: int = 0

    def note(self, sample: Sample, offset: int) -> None:
        """Note a message out of order; `offset`: what the newest one took."""
        self.last = sample.received
        if self.last - self.since > CALM_NS:
            self.since = self.last
            self.offset_ns = self.next_offset_ns
            self.late_ns = self.next_late_ns
            self.next_offset_ns = offset
            self.next_late_ns = 0
        self.offset_ns = min(self.offset_ns, offset)
        self.next_offset_ns = min(self.next_offset_ns, offset)
        late = sample.received - sample.stamp - self.offset_ns
        self.late_ns = max(self.late_ns, late)
        self.next_late_ns = max(self.next_late_ns, late)


class SourceClock:
    """The time of one source. `newest` is its watermark, `limit` the last stamp that may simply be the next one.

    `judges`: False believes every stamp, as for a latched topic, whose publishers send a message once, and where
    another clock has judged before.
    """

    __slots__ = (
        "_behind_at",
        "_behind_count",
        "_behind_since",
        "_disorder",
        "_jumped_at",
        "_suspect",
        "_suspect_at",
        "_suspects",
        "judges",
        "jump_policy",
        "limit",
        "newest",
        "newest_received",
        "window_ns",
    )  # fmt: skip

    def __init__(self, window_ns: int, jump: str = JUMP_RESTART, judges: bool = True) -> None:
        self.judges = judges
        self.jump_policy = jump
        self.window_ns = window_ns if judges else FOREVER_NS
        self.newest = -FOREVER_NS
        self.limit = FOREVER_NS
        self.newest_received = 0
        self._suspect = Sample(0, 0, b"")
        self._suspects = 0
        self._suspect_at = self._behind_at = self._behind_count = self._behind_since = -1
        self._disorder: _Disorder | None = None
        self._jumped_at: int | None = None

    def change(self, window_ns: int, jump: str, judges: bool) -> None:
        """Change what counts as far off, and what a jump does; the watermark stays."""
        self.judges = judges
        self.jump_policy = jump
        self.window_ns = window_ns if judges else FOREVER_NS
        if self.newest > -FOREVER_NS:
            self.limit = self.newest + self.window_ns

    def forget(self) -> None:
        """Forget the watermark: the next message is the first one."""
        self.newest = -FOREVER_NS
        self.limit = FOREVER_NS

    def advance(self, stamp: int, received: int) -> None:
        """Move the watermark to a message."""
        self.newest = stamp
        self.newest_received = received
        self.limit = stamp + self.window_ns

    def judge(self, sample: Sample, serial: int) -> str:
        """The verdict on a message that is not after `newest` and up to `limit`; those are NEXT without being asked.

        `serial`: the messages of the source so far, this one included. NEXT and JUMPED move the watermark."""
        stamp = sample.stamp
        if stamp > self.newest:
            waited = sample.received - self.newest_received
            if stamp - self.newest - waited <= self.window_ns:  # silence: the clock of reception went on as well
                self.advance(stamp, sample.received)
                return NEXT
            return self._jump(sample) if self._again(sample, serial) else AHEAD
        behind = stamp < self.newest and self._runs_behind(sample, serial) and self.jump_policy == JUMP_RESTART
        if behind:
            return self._jump(sample)
        if stamp < self.newest - self.window_ns:
            jumped = self._again(sample, serial) and self.jump_policy == JUMP_RESTART
            return self._jump(sample) if jumped else LATE
        if stamp < self.newest and self.judges:
            self._note_disorder(sample)
        return BETWEEN

    def wait_ns(self, now: int) -> int:
        """How long after it could have been received a message may have to wait for one with an earlier stamp.

        0 for a source that keeps its order; `now` is a time of reception."""
        disorder = self._disorder
        if disorder is None or now - disorder.last > CALM_NS:
            return 0
        return min(disorder.late_ns + disorder.late_ns // _MARGIN_SHARE, DISORDER_NS_MAX)

    def due(self, stamp: int, received: int) -> int:
        """The time at which a message would have been received, had it come as fast as the fastest ones lately.

        For a source that keeps its order, that is the time at which it was."""
        return received if self._disorder is None else min(received, stamp + self._disorder.offset_ns)

    def offset_ns(self) -> int:
        """How far the newest stamp is behind its time of reception; negative where the source's clock is ahead."""
        return self.newest_received - self.newest if self.newest > -FOREVER_NS else 0

    def state(self, now: int, silent: bool) -> str:
        """The state of the source, as `/status` shows it; `silent`: it has sent nothing for too long."""
        if silent or self.newest == -FOREVER_NS:
            return SILENT
        if self._jumped_at is not None and now - self._jumped_at <= JUMPED_NS:
            return JUMPED
        offset = self.offset_ns()
        if abs(offset) > OFFSET_NS:
            return BEHIND if offset > 0 else AHEAD
        return DISORDERED if self.wait_ns(now) else STEADY

    def _jump(self, sample: Sample) -> str:
        self.advance(sample.stamp, sample.received)
        self._jumped_at = sample.received
        self._disorder = None
        return JUMPED

    def _note_disorder(self, sample: Sample) -> None:
        if self.newest - sample.stamp > DISORDER_NS_MAX:
            return
        offset = self.newest_received - self.newest
        disorder = self._disorder
        if disorder is None or sample.received - disorder.last > CALM_NS:
            disorder = self._disorder = _Disorder(sample.received, offset, offset)
        disorder.note(sample, offset)

    def _again(self, sample: Sample, serial: int) -> bool:
        """Return whether the message before this one was far off in the same way: then neither is an outlier.

        In the same way: near to this one, or as much earlier as it was received earlier; or several on one side.
        """
        before = self._suspect
        in_a_row = self._suspect_at == serial - 1
        self._suspect = sample
        self._suspect_at = serial
        apart = sample.stamp - before.stamp
        waited = sample.received - before.received
        if not in_a_row or (before.stamp > self.newest) != (sample.stamp > self.newest):
            self._suspects = 1
            return False
        if not apart and before.data == sample.data:
            return False
        self._suspects += 1
        alike = abs(apart) <= self.window_ns or abs(apart - waited) <= self.window_ns
        return alike or self._suspects >= OUTLIERS_MAX

    def _runs_behind(self, sample: Sample, serial: int) -> bool:
        """Return whether messages have been behind the newest for so long that it is not a matter of order any more."""
        if self._behind_at != serial - 1:
            self._behind_since = sample.received
            self._behind_count = 0
        self._behind_at = serial
        self._behind_count += 1
        lasted = sample.received - self._behind_since >= BEHIND_NS and self._behind_count >= BEHIND_COUNT
        return lasted and self.judges
