"""Reporting of topics that a bridge does not carry, to the managers, by a retained message of its own agent."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence

from robotkube.robots.bridge.core.link_reports import LINKS_TOPIC, LinkFault, report_document
from robotkube.robots.bridge.core.mqtt_client_format import type_topic
from robotkube.robots.bridge.core.settings import BridgedTopic, BridgeSettings
from robotkube.robots.bridge.core.waiting_batches import OutgoingBatch
from robotkube.robots.bridge.loops.connections import BrokerConnection


class LinkReporting:
    """The reporting of one process, in the pod `pod` of a release, begun at `started_ns` (ns since 1970). Nothing is
    sent while everything is carried and always was."""

    def __init__(self, release: str, pod: str, started_ns: int) -> None:
        self._release = release
        self._pod = pod
        self._started_ns = started_ns
        self._reported: tuple[LinkFault, ...] = ()

    def report(self, agent: str, faults: Iterable[LinkFault], connection: BrokerConnection, now: float) -> None:
        """Send what is not carried now, when it differs from what was sent; the message is taken back when it is
        nothing any more."""
        current = tuple(faults)
        if current == self._reported:
            return
        self._reported = current
        topic = f"{LINKS_TOPIC}{agent}/{self._release}"
        if current:
            payload = json.dumps(report_document(self._pod, self._started_ns, current)).encode()
            connection.put(OutgoingBatch(topic, payload, 0, True, now))
        else:
            connection.withdraw(topic)


def link_faults(
    settings: BridgeSettings,
    problems: Mapping[str, str],
    connections: Mapping[str, BrokerConnection],
    discovered: Mapping[str, Sequence[object]],
) -> Iterator[LinkFault]:
    """The topics of the settings that are not carried. `problems` are those that could not be opened, by ROS topic;
    `discovered` ROS topics begin with the general one that they came with."""
    for direction, topics in (("out", settings.outgoing), ("in", settings.incoming)):
        for topic in topics.values():
            refusals = connections[topic.channel].refusals if topic.channel in connections else {}
            reason = next(_reasons(topic, problems, refusals, discovered), "")
            if reason:
                yield LinkFault(direction, topic.name, reason)


def _reasons(
    topic: BridgedTopic,
    problems: Mapping[str, str],
    refusals: Mapping[str, str],
    discovered: Mapping[str, Sequence[object]],
) -> Iterator[str]:
    """Why a topic, or one of those that a general topic stands for, is not carried."""
    own = [name for name, known in discovered.items() if topic.general and known[0] == topic.name]
    failed = [name for name in problems if topic.general and topic.agent(name)]
    yield from (problems[name] for name in (topic.name, *failed) if name in problems)
    topics = [topic.mqtt, topic.filter, type_topic(topic.filter), *(topic.named(name).mqtt for name in own)]
    yield from (f"the broker refuses {refusals[name]}" for name in topics if name in refusals)
