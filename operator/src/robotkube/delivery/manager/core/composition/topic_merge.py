"""Merging of the topics that demands ask bridges for: each topic once per bridge and direction, so that no message is
carried twice."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from robotkube.errors import RefusalError
from robotkube.registry.catalogue.core.applications import TOPIC_KEYS, TOPIC_KEYS_OPTIONAL
from robotkube.robots.bridge.core.rights import IN, OUT

End = tuple[str, str]
"""A bridge: kind of link and place."""

Part = dict[str, dict[str, Mapping[str, Any]]]
"""Topics of one bridge by direction and name."""


class MergedTopics:
    """Topics of bridges by end; grows as topics of others are merged into it."""

    def __init__(self) -> None:
        self._topics: dict[End, Part] = {}
        self._own: set[End] = set()

    def copy(self) -> MergedTopics:
        """Topics that can grow without changing these, and these without changing them."""
        copied = MergedTopics()
        self._own.clear()  # shared from now on
        copied._topics = dict(self._topics)
        return copied

    @property
    def ends(self) -> Iterable[End]:
        """Every bridge that somebody asks for."""
        return self._topics.keys()

    def add(self, kind: str, agent: str, direction: str, topic: Mapping[str, Any]) -> None:
        """Add one topic; RefusalError(CompositionFailed) when the bridge has it otherwise or in the other direction."""
        part: Part = {OUT: {}, IN: {}}
        part[direction][topic["name"]] = topic
        one = MergedTopics()
        one._topics[kind, agent] = part
        self.merge(one)

    def merge(self, other: MergedTopics) -> None:
        """Merge all of `other` into these, or refuse as `add` does and stay as they were."""
        for end, part in other._topics.items():
            mine = self._topics.get(end)
            if mine is not None:
                _agree(end[1], mine, part)
        for end, part in other._topics.items():
            mine = self._topics.setdefault(end, part)
            if mine is not part:
                if end not in self._own:
                    mine = self._topics[end] = {direction: dict(topics) for direction, topics in mine.items()}
                    self._own.add(end)
                for direction, topics in part.items():
                    mine[direction].update(topics)

    def at(self, kind: str, agent: str) -> dict[str, Sequence[Mapping[str, Any]]]:
        """Topics of one bridge by direction, by name."""
        part = self._topics.get((kind, agent), {})
        both = {direction: part.get(direction, {}) for direction in (OUT, IN)}
        return {direction: [topics[name] for name in sorted(topics)] for direction, topics in both.items()}


def _agree(agent: str, mine: Part, part: Part) -> None:
    for direction, topics in part.items():
        present, against = mine[direction], mine[IN if direction == OUT else OUT]
        for name, topic in topics.items():
            known = present.get(name)
            if known is not None and known is not topic and known != topic:
                raise _difference(agent, known, topic)
            if name in against:
                raise RefusalError(
                    "CompositionFailed", f"topic {name} would leave and enter {agent} by its bridge: a loop"
                )


def _difference(agent: str, present: Mapping[str, Any], topic: Mapping[str, Any]) -> RefusalError:
    pairs = [(key, present.get(key), topic.get(key)) for key in (*TOPIC_KEYS, *TOPIC_KEYS_OPTIONAL)]
    differences = ", ".join(f"{key} {one!r} and {other!r}" for key, one, other in pairs if one != other)
    return RefusalError(
        "CompositionFailed", f"topic {topic['name']} at the bridge of {agent} is asked for with {differences}"
    )
