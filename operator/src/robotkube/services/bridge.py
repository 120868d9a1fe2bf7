"""The bridge of a node: ROS topics to MQTT and back, in one loop without threads.

`turn` moves everything that waits and never blocks; the entry point calls it every 20 to 40 ms. Batching by that period
is what makes it cheap: one frame, one packet, one acknowledgement for all messages of a topic since the last turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from robotkube.domain.audits import Gap
from robotkube.domain.bridging import (
    GAPS_DEPTH,
    GAPS_TOPIC,
    GAPS_TYPE,
    MQTT_PREFIX,
    TOPICS_MAX,
    BridgedTopic,
    BridgeSettings,
    difference,
)
from robotkube.domain.bridging_properties import gap_text
from robotkube.domain.errors import InputError
from robotkube.domain.frames import MESSAGES_MAX
from robotkube.domain.messages import string_message
from robotkube.domain.topics import TopicPattern
from robotkube.services.bridge_flows import Incoming, Outgoing, Sender
from robotkube.services.bridge_links import Hold, Link
from robotkube.services.bridge_metrics import Carried, metric_lines
from robotkube.services.ownership import Ownership

if TYPE_CHECKING:  # the ports know every part's domain: 25 ms of a start
    from robotkube.ports.robots import ChannelEvents, FrameChannel, RobotNetwork

    MakeChannel = Callable[[str, str, ChannelEvents], FrameChannel]

NODE_NAME = "mqtt_bridge"
MATCHED_SECONDS = 2.0
SEARCH_SECONDS = 1.0
FORGET_SECONDS = 60.0

Log = Callable[..., None]


class Bridge:
    """Carries topics as `configure` says. All methods belong to one thread, `complaint` and `metrics` to any.

    After a connection was lost and made again, nothing leaves until `ownership` is sure and `hold` was told so."""

    def __init__(
        self, network: RobotNetwork, make_channel: MakeChannel, sender: Sender, log: Log, ownership: Ownership
    ) -> None:
        self._network, self._make_channel, self._sender, self._log = network, make_channel, sender, log
        self._own_trace, self._hold = sender.trace, Hold(ownership)
        self._settings: BridgeSettings | None = None
        self._outgoing: dict[str, Outgoing] = {}
        self._incoming: dict[str, Incoming] = {}
        self._found: dict[str, tuple[str, float]] = {}  # ROS topic -> the general one it is of, and when it was seen
        self._gaps: Incoming | None = None
        self._links: dict[str, Link] = {}
        self._problems: dict[str, str] = {}
        self._matched_at = self._search_at = self._now = 0.0

    @property
    def settings(self) -> BridgeSettings | None:
        """What is carried now."""
        return self._settings

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the connections in use."""
        return tuple(self._links)

    def hold(self, held: bool) -> None:
        """Let what is to be sent wait in its bounds, or no longer: after everything that was read is applied."""
        self._hold.held = held

    def configure(self, settings: BridgeSettings) -> None:
        """Carry these topics from now on. Only what differs is closed and opened; a topic that cannot be opened
        (unknown type) is a complaint, and the others go on."""
        old, self._settings = self._settings, settings
        self._sender.trace = settings.trace or self._own_trace
        outgoing = difference(old.outgoing if old else {}, settings.outgoing)
        incoming = difference(old.incoming if old else {}, settings.incoming)
        for name in outgoing.closed:
            self._close_outgoing(name)
        for name in incoming.closed:
            self._close_incoming(name)
        for name in sorted(settings.channels - set(self._links)):
            self._links[name] = self._link(name, settings.agent)
        for topic in outgoing.opened:
            self._try(topic, self._open_outgoing)
        for topic in incoming.opened:
            self._try(topic, self._open_incoming)
        for name in sorted(set(self._links) - settings.channels):
            self._links.pop(name).close()
        self._tell_gaps(settings.publish_gaps)
        self._search_at = self._now
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
            messages = outgoing.source.take(MESSAGES_MAX)
            if messages:
                outgoing.messages += len(messages)
                link = self._links[outgoing.topic.channel]
                for frame in outgoing.frames(messages, now):
                    link.put(frame)
        for link in self._links.values():
            link.turn(now)
        if self._gaps is not None:
            self._gaps.turn(self._sender.clock())
        if now >= self._matched_at:
            self._matched_at = now + MATCHED_SECONDS
            self._count_matched()
        if now >= self._search_at:
            self._search_at = now + SEARCH_SECONDS
            self._search()

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
        refusals = (sentence for link in list(self._links.values()) for sentence in list(link.refusals.values()))
        return "; ".join([*list(self._problems.values()), *refusals]) or None

    def metrics(self) -> str:
        """Counters in Prometheus' text format."""
        carried = Carried(list(self._outgoing.values()), list(self._incoming.values()), list(self._links.values()))
        lines = [*metric_lines(carried), f"topics_refused {len(self._problems)}", f"held {int(self._hold.held)}"]
        return "".join(f"robotkube_bridge_{line}\n" for line in lines)

    def _link(self, name: str, agent: str) -> Link:
        return Link(name, agent, self._make_channel, self._log, self._sender.clock, self._open_found, self._hold)

    def _count_matched(self) -> None:
        for out in self._outgoing.values():
            out.matched = out.source.matched
        for into in self._incoming.values():
            into.matched = into.sink.matched

    def _try(self, topic: BridgedTopic, opening: Callable[[BridgedTopic], object]) -> None:
        try:
            opening(topic)
            self._problems.pop(topic.name, None)
        except InputError as error:
            self._problems[topic.name] = f"topic {topic.name} is not carried: {error}"

    def _open_outgoing(self, topic: BridgedTopic) -> None:
        if topic.general:
            return  # its topics are searched
        source = self._network.subscribe(topic.name, topic.type, topic.reliability, topic.durability, topic.depth)
        self._outgoing[topic.name] = Outgoing(topic, source, self._sender)
        for frame in self._outgoing[topic.name].introduction(
            self._now, bool(self._settings and self._settings.publish_types)
        ):
            self._links[topic.channel].put(frame)

    def _open_incoming(self, topic: BridgedTopic) -> None:
        incoming = None
        if not topic.general:
            if self._found.pop(topic.name, None) is not None:  # until now it came with a general one
                self._drop_incoming(topic.name)
            incoming = self._advertise(topic)
        self._links[topic.channel].add(topic, incoming)

    def _advertise(self, topic: BridgedTopic) -> Incoming:
        sink = self._network.advertise(topic.name, topic.type, topic.reliability, topic.durability, topic.depth)
        self._incoming[topic.name] = Incoming(topic, sink, self._lost_at_ros, self._found_gaps)
        return self._incoming[topic.name]

    def _open_found(self, general: BridgedTopic, mqtt_topic: str) -> Incoming | None:
        """The topic that a message at the broker is for, when it is one of a general topic."""
        name, settings = mqtt_topic.removeprefix(MQTT_PREFIX), self._settings
        agent = general.agent(name)
        if not agent or settings is None or agent == settings.agent:
            return None
        if name in self._outgoing or name in self._incoming or name in self._problems:
            return None
        if len(self._incoming) + len(self._problems) >= TOPICS_MAX:
            return None
        self._try(general.named(name), self._advertise)
        incoming = self._incoming.get(name)
        if incoming is not None:
            self._found[name] = (general.name, self._now)
            self._log("found", direction="in", topic=name)
        return incoming

    def _search(self) -> None:
        """Begin to send topics that somebody publishes now, and stop when nobody did for FORGET_SECONDS."""
        general = [topic for topic in self._settings.outgoing.values() if topic.general] if self._settings else []
        if not general:
            return
        for endpoint in self._network.endpoints():
            if endpoint.direction != "out" or not endpoint.node or endpoint.node.endswith(f"/{NODE_NAME}"):
                continue  # what a bridge brought in does not go out again
            for topic in general:
                if topic.type == endpoint.type and topic.agent(endpoint.topic):
                    self._send_found(topic, endpoint.topic)
        for name, (_, seen) in list(self._found.items()):
            if name in self._outgoing and self._now > seen + FORGET_SECONDS:
                self._close_outgoing(name)

    def _send_found(self, general: BridgedTopic, name: str) -> None:
        if name in self._incoming or (name not in self._outgoing and len(self._outgoing) >= TOPICS_MAX):
            return
        if name not in self._outgoing:
            self._try(general.named(name), self._open_outgoing)
            self._log("found", direction="out", topic=name)
        elif name not in self._found:
            return  # it is named in the settings
        self._found[name] = (general.name, self._now)

    def _close_outgoing(self, name: str) -> None:
        """Stop sending a topic, or all of a general one."""
        self._forget_problems(name)
        for one in self._of(name, self._outgoing):
            outgoing = self._outgoing.pop(one)
            self._found.pop(one, None)
            outgoing.source.close()
            link = self._links[outgoing.topic.channel]
            link.withdraw(outgoing.topic.mqtt)
            for frame in outgoing.introduction(self._now, True):
                link.withdraw(frame.topic)

    def _close_incoming(self, name: str) -> None:
        """Do not bring in a topic any more, or all of a general one."""
        self._forget_problems(name)
        assert self._settings is not None
        for one in self._of(name, self._incoming):
            self._drop_incoming(one)
        for link in self._links.values():
            if name in link.general:
                link.remove(link.general[name])

    def _forget_problems(self, name: str) -> None:
        """Those of a topic, or of what was found for a general one."""
        general, named = TopicPattern(name), self._settings
        found = [one for one in self._problems if general.agent(one)]
        kept = {*named.outgoing, *named.incoming} if named else set()
        for one in [name, *(one for one in found if one not in kept)]:
            self._problems.pop(one, None)

    def _drop_incoming(self, name: str) -> None:
        incoming = self._incoming.pop(name)
        self._found.pop(name, None)
        self._links[incoming.topic.channel].remove(incoming.topic)
        incoming.sink.close()

    def _of(self, name: str, carried: dict[str, Outgoing] | dict[str, Incoming]) -> list[str]:
        """The topic of that name, or those that were found for it."""
        found = [one for one, (general, _) in self._found.items() if general == name and one in carried]
        return [name, *found] if name in carried else found

    def _lost_at_ros(self, gap: Gap) -> None:
        incoming = self._incoming.get(gap.topic)
        if incoming is not None:
            self._links[incoming.topic.channel].outbox.losses.add(gap)
            if incoming.lost_messages == 1:
                self._log("messages dropped", topic=gap.topic, **gap.document())

    def _tell_gaps(self, wanted: bool) -> None:
        """Open or close the topic on which gaps are told."""
        if not wanted and self._gaps is not None:
            self._gaps.sink.close()
            self._gaps = None
        elif wanted and self._gaps is None:
            topic = BridgedTopic(GAPS_TOPIC, GAPS_TYPE, durability="transient_local", depth=GAPS_DEPTH)
            sink = self._network.advertise(topic.name, topic.type, topic.reliability, topic.durability, topic.depth)
            self._gaps = Incoming(topic, sink, self._lost_at_ros, self._found_gaps)

    def _found_gaps(self, gaps: Sequence[Gap]) -> None:
        """A sender told what is missing in what came in."""
        for gap in gaps:
            self._log("messages missing", topic=gap.topic, **gap.document())
            if self._gaps is not None:
                self._gaps.publish([string_message(gap_text(gap).encode())], self._sender.clock())
