"""Bridge releases: one per place and kind of link, with the topics of all demands."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.accumulated_state import Contribution
from robotkube.delivery.manager.core.composition.expansion import make_release
from robotkube.delivery.manager.core.composition.index import Index
from robotkube.delivery.manager.core.composition.inputs import Refused
from robotkube.delivery.manager.core.composition.topic_merge import End, MergedTopics
from robotkube.errors import DocumentError, RefusalError
from robotkube.foundation.documents.core.value_templates import render_templates

NODE_WORD_MAX = 20


class ImpossibleBridgeError(Exception):
    """The error that a bridge cannot be made for these demands together: `demands` are to be refused, with
    `refused`."""

    def __init__(self, demands: list[str], refused: Refused) -> None:
        super().__init__(refused.message)
        self.demands = demands
        self.refused = refused


def bridge_release(end: End, contributions: Sequence[Contribution], topics: MergedTopics, index: Index) -> Release:
    """The bridge of one place for all who contribute to it. ImpossibleBridgeError names those whose own topics make it
    impossible, else the last that came."""
    try:
        return _make_bridge(end, topics, index)
    except (RefusalError, DocumentError) as error:
        reason = error.reason if isinstance(error, RefusalError) else "CompositionFailed"
        message = error.message if isinstance(error, RefusalError) else str(error)
        guilty = [contribution for contribution in contributions if _fails_alone(end, contribution, index)]
        keys = [one.demand.key for one in guilty or contributions[-1:]]
        raise ImpossibleBridgeError(keys, Refused(reason, message)) from error


def _make_bridge(end: End, topics: MergedTopics, index: Index) -> Release:
    kind, place = end
    service = index.bridge(kind)[0]
    agent = index.fleet.at[place]
    names = {"agent": agent.name, "topics": topics.at(kind, place)}
    name = f"{index.render(service.release, names)}{_node_suffix(agent.node)}"
    pin = index.pins.get(f"{agent.namespace}/{name}")
    chart, _ = index.selector.chart(service.chart, platforms=index.platforms(agent.name), pinned=pin)
    away = agent != index.fleet.home(agent)
    return make_release(agent, name, chart, render_templates(service.values, names, index.render), index, movable=away)


def _fails_alone(end: End, contribution: Contribution, index: Index) -> bool:
    try:
        _make_bridge(end, contribution.expansion.topics, index)
    except (RefusalError, DocumentError):
        return True
    return False


def _node_suffix(node: str) -> str:
    """The part of a bridge's name that differs between an agent's Nodes: the Node's name, or its hash when it is long,
    since the names of releases are short."""
    word = node.replace(".", "-")
    if len(word) > NODE_WORD_MAX:
        word = sha256(node.encode()).hexdigest()[:8]
    return f"-{word}" if word else ""
