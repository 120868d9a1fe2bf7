"""The bridge of a node: ROS topics to MQTT and back, in one loop without threads.

`turn` moves everything that waits and never blocks; the entry point calls it every 20 to 40 ms. Batching by that period
is what makes it cheap: one frame, one packet, one acknowledgement for all messages of a topic since the last turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robotkube.domain.bridging import BULK, BridgedTopic, BridgeSettings, difference
from robotkube.domain.errors import InputError, UnavailableError
from robotkube.domain.frames import FrameError, SeenFrames, decode_frame, encode_frame
from robotkube.domain.messages import string_message, string_text
from robotkube.domain.outboxes import Bounds, Outbox, OutgoingFrame
from robotkube.services.ownership import Ownership

if TYPE_CHECKING:  # the ports know every part's domain: 25 ms of a start
    from robotkube.ports.robots import ChannelEvents, FrameChannel, MessageSink, MessageSource, RobotNetwork

    MakeChannel = Callable[[str, str, ChannelEvents], FrameChannel]

FRAME_BYTES_MAX = 1_000_000
MESSAGES_PER_TURN_MAX = 2000
MATCHED_SECONDS = 2.0
TELEMETRY_BOUNDS = Bounds(seconds_max=60.0, frames_max=60_000, inflight_max=200)
BULK_BOUNDS = Bounds(seconds_max=2.0, frames_max=10, inflight_max=4)

Log = Callable[..., None]


@dataclass
class _Outgoing:
    topic: BridgedTopic
    source: MessageSource
    messages: int = 0
    matched: int = 0


@dataclass
class _Incoming:
    topic: BridgedTopic
    sink: MessageSink
    messages: int = 0
    matched: int = 0
    seen: SeenFrames = field(default_factory=SeenFrames)


@dataclass
class _Hold:
    """Whether what is to be sent waits: between a connection made anew and settings read since then."""

    ownership: Ownership
    held: bool = False

    def doubt(self) -> None:
        """A connection was made anew."""
        self.ownership.doubt()
        self.held = self.held or not self.ownership.sure


class _Link:
    """One connection with what it carries."""

    def __init__(self, name: str, agent: str, make: MakeChannel, log: Log, hold: _Hold) -> None:
        self.name, self._hold = name, hold
        self.outbox = Outbox(BULK_BOUNDS if name == BULK else TELEMETRY_BOUNDS)
        self.incoming: dict[str, _Incoming] = {}
        self.retained: dict[str, OutgoingFrame] = {}
        self.bad_frames = self.lost_sinks = self.connections = 0
        self.refusals: dict[str, str] = {}
        self._log, self._now = log, 0.0
        self.channel = make(agent, name, self)

    def connected(self, session_kept: bool) -> None:
        """Subscribe anew; a broker without a session of ours has lost what it retained, too."""
        self.connections += 1
        if self.connections > 1:
            self._hold.doubt()
        self.refusals.clear()
        self._log("connected", channel=self.name, session_kept=session_kept)
        self.channel.subscribe(list(self.incoming))
        self.outbox.connected(self._now)
        if not session_kept:
            waiting = {frame.payload for frame in self.outbox.waiting}
            for frame in self.retained.values():
                if frame.payload not in waiting:
                    self.outbox.put(frame)

    def disconnected(self) -> None:
        """What was on its way waits again."""
        self._log("disconnected", channel=self.name, reason=self.channel.complaint)
        self.outbox.disconnected(self._now)

    def acknowledged(self, token: int, heard: bool) -> None:
        """The broker has a frame."""
        self.outbox.acknowledged(token, heard, self._now)

    def refused(self, topic: str, reason: str) -> None:
        """Kept as a complaint until the next connection."""
        if topic not in self.refusals:
            self._log("refused by the broker", channel=self.name, topic=topic, reason=reason)
        self.refusals[topic] = f"{topic or self.name}: {reason}; look at the broker's ACL for this agent"

    def received(self, topic: str, payload: bytes) -> None:
        """Publish a frame's messages, unless the frame was here before."""
        incoming = self.incoming.get(topic)
        if incoming is None:
            self.channel.unsubscribe([topic])  # a session of the broker that is older than our settings
            return
        if not payload:
            return  # a retained frame was taken back
        if incoming.topic.door:
            self._publish(incoming, [string_message(payload)])
            return
        try:
            frame = decode_frame(payload)
        except FrameError as error:
            self.count_bad(topic, str(error))
            return
        if incoming.seen.fresh(frame.session, frame.sequence):
            self._publish(incoming, frame.messages)

    def count_bad(self, topic: str, error: str) -> None:
        """Something that cannot be carried; only the first one is told."""
        self.bad_frames += 1
        if self.bad_frames == 1:
            self._log("frame refused", topic=topic, error=error)

    def _publish(self, incoming: _Incoming, messages: Sequence[bytes]) -> None:
        publish = incoming.sink.publish
        for message in messages:
            try:
                publish(message)
                incoming.messages += 1
            except UnavailableError as error:
                self.lost_sinks += 1
                if self.lost_sinks == 1:
                    self._log("message lost", topic=incoming.topic.name, error=str(error))

    def turn(self, now: float) -> None:
        """Read, then hand over as much as the outbox lets go, then write. All events come within a turn."""
        self._now = now
        self.channel.turn(now)
        if self.channel.complaint is None and not self._hold.held:
            self._hand_over(now)
        self.channel.flush()

    def close(self) -> None:
        """Hand over what the connection takes at once, then part from the broker."""
        self.turn(self._now)
        self.channel.close()

    def _hand_over(self, now: float) -> None:
        while (frame := self.outbox.next(now)) is not None:
            token = self.channel.publish(frame.topic, frame.payload, frame.retained)
            if token is None:
                self.outbox.give_back(frame)
                return
            self.outbox.sent(token, frame)


class Bridge:
    """Carries topics as `configure` says. All methods belong to one thread, `complaint` and `metrics` to any.

    After a connection was lost and made again, nothing leaves until `ownership` is sure and `hold` was told so."""

    def __init__(
        self, network: RobotNetwork, make_channel: MakeChannel, session: int, log: Log, ownership: Ownership
    ) -> None:
        self._network, self._make_channel, self._session, self._log = network, make_channel, session, log
        self._hold = _Hold(ownership)
        self._settings: BridgeSettings | None = None
        self._outgoing: dict[str, _Outgoing] = {}
        self._incoming: dict[str, _Incoming] = {}
        self._links: dict[str, _Link] = {}
        self._sequences: dict[str, int] = {}
        self._problems: dict[str, str] = {}
        self._matched_at = self._now = 0.0

    @property
    def settings(self) -> BridgeSettings | None:
        """What is carried now."""
        return self._settings

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the connections in use."""
        return tuple(self._links)

    @property
    def sinks_matched(self) -> bool:
        """Whether every publisher has found a subscription."""
        return all(incoming.sink.matched for incoming in self._incoming.values())

    def hold(self, held: bool) -> None:
        """Let what is to be sent wait in its bounds, or no longer: after everything that was read is applied."""
        self._hold.held = held

    def configure(self, settings: BridgeSettings) -> None:
        """Carry these topics from now on. Only what differs is closed and opened; a topic that cannot be opened
        (unknown type) is a complaint, and the others go on."""
        old = self._settings
        outgoing = difference(old.outgoing if old else {}, settings.outgoing)
        incoming = difference(old.incoming if old else {}, settings.incoming)
        for name in outgoing.closed:
            self._close_outgoing(name)
        for name in incoming.closed:
            self._close_incoming(name)
        for name in sorted(settings.channels - set(self._links)):
            self._links[name] = _Link(name, settings.agent, self._make_channel, self._log, self._hold)
        for topic in outgoing.opened:
            self._try(topic, self._open_outgoing)
        for topic in incoming.opened:
            self._try(topic, self._open_incoming)
        for name in sorted(set(self._links) - settings.channels):
            self._links.pop(name).close()
        self._settings = settings
        self._log(
            "configured",
            out=len(settings.outgoing),
            **{"in": len(settings.incoming)},
            opened=[topic.name for topic in (*outgoing.opened, *incoming.opened)],
            closed=[*outgoing.closed, *incoming.closed],
            problems=list(self._problems.values()),
        )

    def turn(self, now: float) -> None:
        """Move everything that waits. `now` in seconds of a clock that never goes back."""
        self._now = now
        for outgoing in self._outgoing.values():
            messages = outgoing.source.take(MESSAGES_PER_TURN_MAX)
            if messages:
                self._send(outgoing, messages, now)
        for link in self._links.values():
            link.turn(now)
        if now >= self._matched_at:
            self._matched_at = now + MATCHED_SECONDS
            for out in self._outgoing.values():
                out.matched = out.source.matched
            for into in self._incoming.values():
                into.matched = into.sink.matched

    def turn_channel(self, name: str, now: float) -> None:
        """Move what waits on one connection."""
        if name in self._links:
            self._links[name].turn(now)

    def close(self) -> None:
        """Hand over what the connections take at once, then part from the broker."""
        self._log(
            "closing",
            out={name: out.messages for name, out in self._outgoing.items()},
            **{"in": {name: into.messages for name, into in self._incoming.items()}},
            queued={name: len(link.outbox) for name, link in self._links.items()},
            dropped={name: link.outbox.dropped for name, link in self._links.items()},
        )
        for link in self._links.values():
            link.close()

    @property
    def complaint(self) -> str | None:
        """None when ready: settings applied, every topic open, every connection made."""
        if self._settings is None:
            return "no settings yet"
        for link in list(self._links.values()):
            if link.channel.complaint is not None:
                return link.channel.complaint
        sentences = [*self._problems.values(), *(r for link in self._links.values() for r in link.refusals.values())]
        return "; ".join(sentences) or None

    def metrics(self) -> str:
        """Counters in Prometheus' text format."""
        return "".join(f"robotkube_bridge_{line}\n" for line in self._metric_lines())

    def _metric_lines(self) -> Iterator[str]:
        for out in list(self._outgoing.values()):
            yield f'messages_total{{direction="out",topic="{out.topic.name}"}} {out.messages}'
            yield f'matched_sources{{topic="{out.topic.name}"}} {out.matched}'
        for into in list(self._incoming.values()):
            name = into.topic.name
            yield f'messages_total{{direction="in",topic="{name}"}} {into.messages}'
            yield f'matched_sinks{{topic="{name}"}} {into.matched}'
            yield f'duplicate_frames_total{{topic="{name}"}} {into.seen.duplicates}'
            yield f'missing_frames{{topic="{name}"}} {into.seen.missing}'
        for name, link in list(self._links.items()):
            yield f'connected{{channel="{name}"}} {int(link.channel.complaint is None)}'
            yield f'connections_total{{channel="{name}"}} {link.connections}'
            yield f'queued_frames{{channel="{name}"}} {len(link.outbox)}'
            yield f'dropped_messages_total{{channel="{name}"}} {link.outbox.dropped}'
            yield f'refused_frames_total{{channel="{name}"}} {link.bad_frames}'
            yield f'lost_messages_total{{channel="{name}"}} {link.lost_sinks}'
        yield f"topics_refused {len(self._problems)}"
        yield f"held {int(self._hold.held)}"

    def _send(self, outgoing: _Outgoing, messages: Sequence[bytes], now: float) -> None:
        topic = outgoing.topic
        link = self._links[topic.channel]
        outgoing.messages += len(messages)
        if topic.door:
            _send_texts(link, topic, messages, now)
            return
        for part in _parts(messages):
            sequence = self._sequences.get(topic.name, 0)
            self._sequences[topic.name] = sequence + 1
            payload = encode_frame(self._session, sequence, part)
            frame = OutgoingFrame(topic.mqtt, payload, len(part), topic.retained, now)
            link.outbox.put(frame)
            if topic.retained:
                link.retained[topic.name] = frame

    def _try(self, topic: BridgedTopic, opening: Callable[[BridgedTopic], None]) -> None:
        try:
            opening(topic)
            self._problems.pop(topic.name, None)
        except InputError as error:
            self._problems[topic.name] = f"topic {topic.name} is not carried: {error}"

    def _open_outgoing(self, topic: BridgedTopic) -> None:
        source = self._network.subscribe(topic.name, topic.type, topic.reliability, topic.durability, topic.depth)
        self._outgoing[topic.name] = _Outgoing(topic, source)

    def _open_incoming(self, topic: BridgedTopic) -> None:
        sink = self._network.advertise(topic.name, topic.type, topic.reliability, topic.durability, topic.depth)
        incoming = _Incoming(topic, sink)
        self._incoming[topic.name] = incoming
        link = self._links[topic.channel]
        link.incoming[topic.mqtt] = incoming
        link.channel.subscribe([topic.mqtt])

    def _close_outgoing(self, name: str) -> None:
        self._problems.pop(name, None)
        outgoing = self._outgoing.pop(name, None)
        if outgoing is None:
            return
        outgoing.source.close()
        link = self._links[outgoing.topic.channel]
        link.outbox.forget(outgoing.topic.mqtt)
        if link.retained.pop(name, None) is not None and not self._hold.held:  # else it may be somebody else's by now
            link.outbox.put(OutgoingFrame(outgoing.topic.mqtt, b"", 0, True, self._now))

    def _close_incoming(self, name: str) -> None:
        self._problems.pop(name, None)
        incoming = self._incoming.pop(name, None)
        if incoming is None:
            return
        link = self._links[incoming.topic.channel]
        link.incoming.pop(incoming.topic.mqtt, None)
        link.channel.unsubscribe([incoming.topic.mqtt])
        incoming.sink.close()


def _send_texts(link: _Link, topic: BridgedTopic, messages: Sequence[bytes], now: float) -> None:
    """The texts of String messages, each as it is."""
    for message in messages:
        try:
            link.outbox.put(OutgoingFrame(topic.mqtt, string_text(message), 1, born=now))
        except ValueError as error:
            link.count_bad(topic.mqtt, str(error))


def _parts(messages: Sequence[bytes]) -> Iterator[Sequence[bytes]]:
    """`messages` in runs of at most FRAME_BYTES_MAX bytes; a larger message stands alone."""
    begin, size = 0, 0
    for index, message in enumerate(messages):
        size += len(message)
        if size > FRAME_BYTES_MAX and index > begin:
            yield messages[begin:index]
            begin, size = index, len(message)
    yield messages[begin:]
