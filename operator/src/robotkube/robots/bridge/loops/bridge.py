"""The bridge of a node: ROS topics to MQTT and back, in one loop without threads.

`turn` moves everything that waits and never blocks; the entry point calls it every 20 to 40 ms. Batching by that period
is what makes it cheap: one batch, one packet, one acknowledgement for all messages of a topic since the last turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from robotkube.errors import InputError
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.robots.bridge.core.settings import TELEMETRY, TOPICS_MAX, BridgedTopic, BridgeSettings, difference
from robotkube.robots.bridge.loops.connections import BrokerConnection, SendPause
from robotkube.robots.bridge.loops.flows import Incoming, Outgoing, SendingSession
from robotkube.robots.bridge.loops.link_reporting import LinkReporting, link_faults
from robotkube.robots.bridge.loops.metrics import BridgeState, metric_lines
from robotkube.robots.bridge.loops.sending_order import SendingOrder
from robotkube.robots.mqtt.core.batches import MESSAGES_MAX
from robotkube.robots.mqtt.core.message_properties import GAPS_DEPTH, GAPS_TOPIC, GAPS_TYPE, MQTT_PREFIX, gap_text
from robotkube.robots.ros.core.common_messages import string_message
from robotkube.robots.ros.core.gaps import Gap
from robotkube.robots.ros.core.topic_patterns import TopicPattern

if TYPE_CHECKING:  # the ports know every part's domain: 25 ms of a start
    from robotkube.robots.mqtt.ports import ChannelEvents, MqttChannel
    from robotkube.robots.ros.ports import RobotNetwork

    MakeChannel = Callable[[str, str, ChannelEvents], MqttChannel]

NODE_NAME = "mqtt_bridge"
MATCHED_SECONDS = 2.0
SEARCH_SECONDS = 1.0
FORGET_SECONDS = 60.0

Log = Callable[..., None]


class Bridge:
    """Carries topics as `configure` says. All methods belong to one thread, but for `complaint`, `not_carried` and
    `metrics`, which belong to any.

    After a connection was lost and made again, nothing leaves until the release is no longer fenced (`fencing` is
    sure) and `hold` was called with that. `reporting` tells managers which topics are not carried."""

    def __init__(
        self,
        network: RobotNetwork,
        make_channel: MakeChannel,
        sender: SendingSession,
        log: Log,
        fencing: Fencing,
        reporting: LinkReporting | None = None,
    ) -> None:
        self._network = network
        self._make_channel = make_channel
        self._sender = sender
        self._log = log
        self._own_trace = sender.trace
        self._pause = SendPause(fencing)
        self._reporting = reporting
        self._settings: BridgeSettings | None = None
        self._outgoing: dict[str, Outgoing] = {}
        self._incoming: dict[str, Incoming] = {}
        self._discovered: dict[str, tuple[str, float]] = {}  # ROS topic -> its general topic, and when it was seen
        self._gaps: Incoming | None = None
        self._links: dict[str, BrokerConnection] = {}
        self._order = SendingOrder()
        self._problems: dict[str, str] = {}
        self._matched_at = self._search_at = 0.0
        self._now = 0.0

    @property
    def settings(self) -> BridgeSettings | None:
        """The settings that are applied now."""
        return self._settings

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the connections in use."""
        return tuple(self._links)

    def hold(self, held: bool) -> None:
        """Let outgoing batches wait in their bounds, or no longer: called after everything that was read is applied."""
        self._pause.held = held

    def configure(self, settings: BridgeSettings) -> None:
        """Carry these topics from now on. Only what differs is closed and opened; a topic that cannot be opened
        (unknown type) is not carried, and the others go on."""
        old = self._settings
        self._settings = settings
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
        self._publish_gaps(settings.publish_gaps)
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
                for batch in outgoing.batches(messages, now):
                    link.put(batch)
        self.turn_connections(now)
        if self._gaps is not None:
            self._gaps.turn(self._sender.clock())
        if now >= self._matched_at:
            self._matched_at = now + MATCHED_SECONDS
            self._count_matched()
        if now >= self._search_at:
            self._search_at = now + SEARCH_SECONDS
            self._search()
            self._report_links()

    def turn_connections(self, now: float) -> None:
        """Move what waits on the connections."""
        self._order.turn(self._links, now)

    @property
    def yielding(self) -> frozenset[str]:
        """The connections that leave the network to more urgent ones."""
        return self._order.yielding

    def close(self) -> None:
        """Send what the connections accept at once, then leave the broker."""
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
        """The reason why the bridge is not ready; None: settings applied, every connection made. What cannot be carried
        of one topic is none: the bridge serves other applications as well."""
        if self._settings is None:
            return "no settings yet"
        for link in list(self._links.values()):
            if link.channel.complaint is not None:
                return link.channel.complaint
        return None

    @property
    def not_carried(self) -> list[str]:
        """What of the topics is not carried, and why: a sentence each; forgotten with the topic."""
        refusals = (sentence for link in list(self._links.values()) for sentence in list(link.refusals.values()))
        return [*list(self._problems.values()), *refusals]

    def metrics(self) -> str:
        """Counters in Prometheus' text format."""
        carried = BridgeState(list(self._outgoing.values()), list(self._incoming.values()), list(self._links.values()))
        lines = [*metric_lines(carried), f"topics_refused {len(self.not_carried)}", f"held {int(self._pause.held)}"]
        return "".join(f"robotkube_bridge_{line}\n" for line in lines)

    def _link(self, name: str, agent: str) -> BrokerConnection:
        return BrokerConnection(
            name, agent, self._make_channel, self._log, self._sender.clock, self._open_discovered, self._pause
        )

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
        for batch in self._outgoing[topic.name].introduction(
            self._now, bool(self._settings and self._settings.publish_types)
        ):
            self._links[topic.channel].put(batch)

    def _open_incoming(self, topic: BridgedTopic) -> None:
        incoming = None
        if not topic.general:
            if self._discovered.pop(topic.name, None) is not None:  # until now it came with a general one
                self._drop_incoming(topic.name)
            incoming = self._advertise(topic)
        self._links[topic.channel].add(topic, incoming)

    def _advertise(self, topic: BridgedTopic) -> Incoming:
        sink = self._network.advertise(topic.name, topic.type, topic.reliability, topic.durability, topic.depth)
        self._incoming[topic.name] = Incoming(topic, sink, self._note_loss, self._report_gaps)
        return self._incoming[topic.name]

    def _open_discovered(self, general: BridgedTopic, mqtt_topic: str) -> Incoming | None:
        """Open the topic that a message at the broker is for; None when it is none of the general topic's."""
        name = mqtt_topic.removeprefix(MQTT_PREFIX)
        settings = self._settings
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
            self._discovered[name] = (general.name, self._now)
            self._log("topic discovered", direction="in", topic=name)
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
                    self._send_discovered(topic, endpoint.topic)
        for name, (_, seen) in list(self._discovered.items()):
            if name in self._outgoing and self._now > seen + FORGET_SECONDS:
                self._close_outgoing(name)

    def _send_discovered(self, general: BridgedTopic, name: str) -> None:
        if name in self._incoming or (name not in self._outgoing and len(self._outgoing) >= TOPICS_MAX):
            return
        if name not in self._outgoing:
            self._try(general.named(name), self._open_outgoing)
            self._log("topic discovered", direction="out", topic=name)
        elif name not in self._discovered:
            return  # it is named in the settings
        self._discovered[name] = (general.name, self._now)

    def _close_outgoing(self, name: str) -> None:
        """Stop sending a topic, or all of a general one."""
        self._forget_problems(name)
        for topic in self._of(name, self._outgoing):
            outgoing = self._outgoing.pop(topic)
            self._discovered.pop(topic, None)
            outgoing.source.close()
            link = self._links[outgoing.topic.channel]
            link.withdraw(outgoing.topic.mqtt)
            for batch in outgoing.introduction(self._now, True):
                link.withdraw(batch.topic)

    def _close_incoming(self, name: str) -> None:
        """Do not bring in a topic any more, or all of a general one."""
        self._forget_problems(name)
        assert self._settings is not None
        for topic in self._of(name, self._incoming):
            self._drop_incoming(topic)
        for link in self._links.values():
            if name in link.general:
                link.remove(link.general[name])

    def _forget_problems(self, name: str) -> None:
        """Forget the problems of a topic, or of those that were discovered for a general one."""
        general = TopicPattern(name)
        settings = self._settings
        discovered = [topic for topic in self._problems if general.agent(topic)]
        kept = {*settings.outgoing, *settings.incoming} if settings else set()
        for topic in [name, *(topic for topic in discovered if topic not in kept)]:
            self._problems.pop(topic, None)

    def _drop_incoming(self, name: str) -> None:
        incoming = self._incoming.pop(name)
        self._discovered.pop(name, None)
        self._links[incoming.topic.channel].remove(incoming.topic)
        incoming.sink.close()

    def _of(self, name: str, carried: dict[str, Outgoing] | dict[str, Incoming]) -> list[str]:
        """The topic of that name, or those that were discovered for it."""
        topics = [topic for topic, (general, _) in self._discovered.items() if general == name and topic in carried]
        return [name, *topics] if name in carried else topics

    def _note_loss(self, gap: Gap) -> None:
        """Note messages that the middleware did not accept."""
        incoming = self._incoming.get(gap.topic)
        if incoming is not None:
            self._links[incoming.topic.channel].outbox.losses.add(gap)
            if incoming.lost_messages == 1:
                self._log("messages dropped", topic=gap.topic, **gap.document())

    def _report_links(self) -> None:
        """Tell managers what is not carried, when that changed; what can be told is on the connection that is always
        there."""
        if self._reporting is not None and self._settings is not None:
            faults = link_faults(self._settings, self._problems, self._links, self._discovered)
            self._reporting.report(self._settings.agent, faults, self._links[TELEMETRY], self._now)

    def _publish_gaps(self, wanted: bool) -> None:
        """Open or close the topic on which gaps are published."""
        if not wanted and self._gaps is not None:
            self._gaps.sink.close()
            self._gaps = None
        elif wanted and self._gaps is None:
            topic = BridgedTopic(GAPS_TOPIC, GAPS_TYPE, durability="transient_local", depth=GAPS_DEPTH)
            sink = self._network.advertise(topic.name, topic.type, topic.reliability, topic.durability, topic.depth)
            self._gaps = Incoming(topic, sink, self._note_loss, self._report_gaps)

    def _report_gaps(self, gaps: Sequence[Gap]) -> None:
        """Log and publish the gaps that a sender reported with its messages."""
        for gap in gaps:
            self._log("messages missing", topic=gap.topic, **gap.document())
            if self._gaps is not None:
                self._gaps.publish([string_message(gap_text(gap).encode())], self._sender.clock())
