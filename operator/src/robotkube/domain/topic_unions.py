"""Topics that demands ask the bridges for: one union per bridge and direction, so that no message crosses twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

from robotkube.domain.catalogue_applications import TOPIC_KEYS
from robotkube.domain.errors import RefusalError

OUT, IN = "out", "in"

_Owner = TypeVar("_Owner")


class TopicUnion(Generic[_Owner]):
    """Topics by (kind of link, agent), direction and name, and who asks for each bridge."""

    def __init__(self) -> None:
        self._topics: dict[tuple[str, str, str], dict[str, Mapping[str, Any]]] = {}
        self.owners: dict[tuple[str, str], list[_Owner]] = {}

    def copy(self) -> TopicUnion[_Owner]:
        """A union that can grow without changing this one."""
        found: TopicUnion[_Owner] = TopicUnion()
        found._topics = {end: dict(topics) for end, topics in self._topics.items()}
        found.owners = {bridge: list(owners) for bridge, owners in self.owners.items()}
        return found

    def owned_by(self, owner: _Owner) -> TopicUnion[_Owner]:
        """The same topics, asked for by somebody else."""
        found = self.copy()
        found.owners = {bridge: [owner] for bridge in self.owners}
        return found

    def add(self, kind: str, agent: str, direction: str, topic: Mapping[str, Any], owner: _Owner) -> None:
        """Add one topic; RefusalError(CompositionFailed) when the bridge has it otherwise or in the other direction."""
        topics = self._topics.setdefault((kind, agent, direction), {})
        _same(agent, topics.get(topic["name"]), topic)
        if topic["name"] in self._topics.get((kind, agent, IN if direction == OUT else OUT), {}):
            raise RefusalError(
                "CompositionFailed", f"topic {topic['name']} would leave and enter {agent} by its bridge: a loop"
            )
        topics[topic["name"]] = topic
        owners = self.owners.setdefault((kind, agent), [])
        if owner not in owners:
            owners.append(owner)

    def merged(self, other: TopicUnion[_Owner]) -> TopicUnion[_Owner]:
        """Both together; refuses as `add`."""
        found = self.copy()
        for (kind, agent, direction), topics in other._topics.items():
            for topic in topics.values():
                for owner in other.owners[kind, agent]:
                    found.add(kind, agent, direction, topic, owner)
        return found

    def at(self, kind: str, agent: str) -> dict[str, Sequence[Mapping[str, Any]]]:
        """Topics of one bridge by direction, by name."""
        return {direction: self._sorted((kind, agent, direction)) for direction in (OUT, IN)}

    def _sorted(self, end: tuple[str, str, str]) -> Sequence[Mapping[str, Any]]:
        topics = self._topics.get(end, {})
        return [topics[name] for name in sorted(topics)]


def _same(agent: str, present: Mapping[str, Any] | None, topic: Mapping[str, Any]) -> None:
    if present is None or present == topic:
        return
    differences = ", ".join(f"{k} {present[k]!r} and {topic[k]!r}" for k in TOPIC_KEYS if present[k] != topic[k])
    raise RefusalError(
        "CompositionFailed", f"topic {topic['name']} at the bridge of {agent} is asked for with {differences}"
    )
