"""Plays a bag on the clock that all players share, and keeps the ledger of what it published.

A message is due at `start + offset` of the wall clock, absolutely: a stall is made up for, nothing drifts, nothing is
left out. A player that comes back in the middle of a run goes on where its ledger ends, without what was missed. A run
of several laps has no ledger.

Messages are prepared some at a time (stamp, hash, line) and passed on together, so that nothing but the publication
is left when one is due: a hundred times a second its code comes from memory, not from the processor's caches, and costs
many times as much.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from robotkube.errors import UnavailableError
from robotkube.robots.bags.core.playback import (
    LATE_NS,
    BagTopic,
    LedgerState,
    PlaybackRun,
    ledger_end,
    ledger_line,
    restamped,
)
from robotkube.robots.ros.core.common_messages import STAMPED_TYPES

if TYPE_CHECKING:  # the ports know every part's domain: 25 ms of a start
    from robotkube.robots.bags.ports.player import Bag, Ledgers, PlaybackClock
    from robotkube.robots.ros.ports import MessageSink, RobotNetwork

IDLE_NS = 200_000_000
FLUSH_NS = 1_000_000_000
AHEAD_NS = 100_000_000
"""Messages of so long a time are prepared together."""
AHEAD_MAX = 100
"""Not more of them at once."""


@dataclass
class PlaybackCounts:
    """Counters of all runs of this process."""

    published: int = 0
    late: int = 0
    skipped: int = 0
    runs: int = 0


@dataclass
class _TopicPlayback:
    """A topic of the bag in the run that is played. `sequence`: number of its next message in the bag;
    `next_sequence`: first number that the ledger does not have; `messages`: number of those in the ledger."""

    topic: BagTopic
    sink: MessageSink
    next_sequence: int
    messages: int
    ended: bool
    sequence: int = 0

    def message(self, data: bytes, due: int) -> bytes:
        """The message as it is published: stamped with `due` when the type has a header."""
        return restamped(data, due) if self.topic.type in STAMPED_TYPES else data


class _NoLedgers:
    """Keeps nothing: the ledgers of a run of several laps."""

    def open(self, run: str, topic: str) -> LedgerState:
        """Nothing was published before."""
        return LedgerState()

    def append(self, topic: str, line: str) -> None:
        """Forget the line."""

    def flush(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class _Ready(NamedTuple):
    """A message with its ledger line, to be published when it is due."""

    playback: _TopicPlayback
    due: int
    data: bytes
    line: str


@dataclass
class Player:
    """Plays runs as they are ordered. `order` may be called from any thread, `serve` runs on one until `stopped`."""

    network: RobotNetwork
    bag: Bag
    ledgers: Ledgers
    clock: PlaybackClock
    log: Callable[..., None]
    stopped: Callable[[], bool]
    counts: PlaybackCounts = field(default_factory=PlaybackCounts)
    _ordered: PlaybackRun | None = None
    _sinks: dict[str, MessageSink] = field(default_factory=dict)
    _published: list[_Ready] = field(default_factory=list)
    _open: Ledgers = field(default_factory=_NoLedgers)

    def __post_init__(self) -> None:
        for topic in self.bag.topics:
            self._sinks[topic.name] = self.network.advertise(
                topic.name, topic.type, topic.reliability, topic.durability, topic.depth
            )

    def order(self, run: PlaybackRun | None) -> None:
        """Order the run to play from now on; None: be silent."""
        self._ordered = run

    def serve(self) -> None:
        """Play what is ordered until the process shall end."""
        done: PlaybackRun | None = None
        while not self.stopped():
            run = self._ordered
            if run is None or run == done:
                self.clock.sleep(IDLE_NS)
                continue
            self._play_laps(run)
            done = run

    def _play_laps(self, run: PlaybackRun) -> None:
        """Play the run once, or its laps from the one that is due."""
        for number in range(run.current_lap(self.clock.now()), run.laps):
            if self._interrupted(run):
                return
            self._play(run, run.start + number * run.lap)

    @property
    def matched(self) -> dict[str, int]:
        """Connected subscriptions per topic."""
        return {name: sink.matched for name, sink in self._sinks.items()}

    def metrics(self) -> str:
        """Counters in Prometheus' text format."""
        counts = self.counts
        matched = "".join(
            f'robotkube_player_matched_subscriptions{{topic="{name}"}} {count}\n'
            for name, count in self.matched.items()
        )
        return (
            f"robotkube_player_messages_total {counts.published}\nrobotkube_player_late_messages_total {counts.late}\n"
            f"robotkube_player_skipped_messages_total {counts.skipped}\nrobotkube_player_runs_total {counts.runs}\n"
            f"{matched}"
        )

    def _play(self, run: PlaybackRun, start: int) -> None:
        self._open = self.ledgers if run.laps == 1 else _NoLedgers()
        playbacks = self._playbacks(run)
        self.counts.runs += 1
        resumed = run.laps > 1 or any(playback.messages for playback in playbacks.values())
        self.log("run begins", run=run.id, start=start, resumed=resumed)
        try:
            finished = self._messages(run, start, playbacks, self.clock.now() - LATE_NS if resumed else None)
            if finished:
                self._end(playbacks)
        finally:
            self._fill_ledgers()
            self._open.close()
        self.log("run ended", run=run.id, finished=finished, published=self.counts.published, late=self.counts.late)

    def _playbacks(self, run: PlaybackRun) -> dict[str, _TopicPlayback]:
        playbacks = {}
        for topic in self.bag.topics:
            state = self._open.open(run.id, topic.name)
            sink = self._sinks[topic.name]
            playbacks[topic.name] = _TopicPlayback(topic, sink, state.next_sequence, state.messages, state.ended)
        return playbacks

    def _messages(self, run: PlaybackRun, start: int, playbacks: dict[str, _TopicPlayback], missed: int | None) -> bool:
        """Play all messages but those due before `missed`; whether the bag was played to its end."""
        flush_at = 0
        for batch in _ahead(self.bag.messages()):
            ready = self._prepared(start, playbacks, batch, missed)
            self._fill_ledgers()
            if (now := self.clock.now()) >= flush_at:
                self._open.flush()
                flush_at = now + FLUSH_NS
            if not self._publish(run, ready):
                return False
        self._fill_ledgers()
        return True

    def _prepared(
        self,
        start: int,
        playbacks: dict[str, _TopicPlayback],
        batch: Sequence[tuple[str, int, bytes]],
        missed: int | None,
    ) -> list[_Ready]:
        """The messages of the batch that are to be published; those due before `missed` are not."""
        ready = []
        for name, offset, data in batch:
            playback = playbacks[name]
            due = start + offset
            sequence = playback.sequence
            playback.sequence += 1
            if sequence < playback.next_sequence or (missed is not None and due < missed):
                self._skip(playback, sequence, data, due)
                continue
            message = playback.message(data, due)
            line = ledger_line(sequence, due, hashlib.sha256(message).hexdigest())
            ready.append(_Ready(playback, due, message, line))
        return ready

    def _publish(self, run: PlaybackRun, ready: Sequence[_Ready]) -> bool:
        """Publish each message when it is due; False when the run shall not go on."""
        now = self.clock.now
        sleep = self.clock.sleep
        counts = self.counts
        while ready:
            while (left := ready[0].due - now()) > IDLE_NS:
                sleep(min(left - IDLE_NS, IDLE_NS))
                self._fill_ledgers()
                self._open.flush()
                if self._interrupted(run):
                    return False
            if self._interrupted(run):
                return False
            outcome = self.network.publish_due([(m.playback.sink, m.due, m.data) for m in ready], LATE_NS)
            self._published += ready[: outcome.published]
            counts.published += outcome.published
            counts.late += outcome.late
            if outcome.refusal:
                topic = ready[outcome.published].playback.topic.name
                raise UnavailableError(f"topic {topic}: the middleware did not accept a message: {outcome.refusal}")
            ready = ready[outcome.published :]
        return True

    def _fill_ledgers(self) -> None:
        """Put what was published into the ledgers."""
        for message in self._published:
            self._open.append(message.playback.topic.name, message.line)
            message.playback.messages += 1
        self._published.clear()

    def _skip(self, playback: _TopicPlayback, sequence: int, data: bytes, due: int) -> None:
        """Skip a message of an earlier life of this player, or missed between the two; late subscribers of latched
        topics still need it."""
        if playback.topic.latched:
            playback.sink.publish(playback.message(data, due))
        if sequence >= playback.next_sequence:
            self.counts.skipped += 1

    def _end(self, playbacks: dict[str, _TopicPlayback]) -> None:
        for name, playback in playbacks.items():
            if not playback.ended:
                self._open.append(name, ledger_end(playback.messages))

    def _interrupted(self, run: PlaybackRun) -> bool:
        return self.stopped() or (self._ordered is not run and self._ordered != run)


def _ahead(messages: Iterable[tuple[str, int, bytes]]) -> Iterator[list[tuple[str, int, bytes]]]:
    """The messages in batches of AHEAD_NS and AHEAD_MAX."""
    batch: list[tuple[str, int, bytes]] = []
    for message in messages:
        if batch and (message[1] - batch[0][1] >= AHEAD_NS or len(batch) >= AHEAD_MAX):
            yield batch
            batch = []
        batch.append(message)
    if batch:
        yield batch
