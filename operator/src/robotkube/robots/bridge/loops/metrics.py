"""The metrics of a bridge in Prometheus' text format. Labels are names of the settings, so there are not many."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robotkube.robots.bridge.core.settings import MQTT_CLIENT

if TYPE_CHECKING:
    from robotkube.robots.bridge.loops.connections import BrokerConnection
    from robotkube.robots.bridge.loops.flows import Incoming, Outgoing


@dataclass(frozen=True)
class BridgeState:
    """A bridge's topics and connections at one moment."""

    outgoing: Sequence[Outgoing]
    incoming: Sequence[Incoming]
    links: Sequence[BrokerConnection]


def metric_lines(carried: BridgeState) -> Iterator[str]:
    """The lines of the metrics: names without their prefix, labels and values."""
    for out in carried.outgoing:
        yield f'messages_total{{direction="out",topic="{out.topic.name}"}} {out.messages}'
        yield f'malformed_messages_total{{topic="{out.topic.name}"}} {out.malformed}'
        yield f'matched_sources{{topic="{out.topic.name}"}} {out.matched}'
    for into in carried.incoming:
        yield from _incoming(into)
    for link in carried.links:
        yield from _link(link)


def _incoming(into: Incoming) -> Iterator[str]:
    name = into.topic.name
    yield f'messages_total{{direction="in",topic="{name}"}} {into.messages}'
    yield f'matched_sinks{{topic="{name}"}} {into.matched}'
    yield f'duplicate_batches_total{{topic="{name}"}} {into.seen.duplicates}'
    yield f'missing_batches{{topic="{name}"}} {into.seen.missing}'
    if into.topic.format == MQTT_CLIENT and into.stamped:
        yield f'latency_seconds{{topic="{name}"}} {into.latency_seconds:.6f}'


def _link(link: BrokerConnection) -> Iterator[str]:
    name = link.name
    yield f'connected{{channel="{name}"}} {int(link.channel.complaint is None)}'
    yield f'connections_total{{channel="{name}"}} {link.connections}'
    yield f'queued_batches{{channel="{name}"}} {len(link.outbox)}'
    yield f'queued_bytes{{channel="{name}"}} {link.outbox.bytes}'
    yield f'paced{{channel="{name}"}} {int(link.outbox.paced)}'
    yield f'refused_batches_total{{channel="{name}"}} {link.refused_batches}'
    for gap in link.outbox.losses.sums:
        labels = f'channel="{name}",topic="{gap.topic}",where="{gap.where}",why="{_quoted(gap.why)}"'
        yield f"dropped_messages_total{{{labels}}} {gap.count}"
        yield f"dropped_first_stamp_seconds{{{labels}}} {gap.first / 1e9:.9f}"
        yield f"dropped_last_stamp_seconds{{{labels}}} {gap.last / 1e9:.9f}"


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ")
