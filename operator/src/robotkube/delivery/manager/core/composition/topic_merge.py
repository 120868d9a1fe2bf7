"""Merging of the topics that demands ask bridges for: each topic once per bridge and direction, so that no message is
carried twice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from robotkube.errors import RefusalError
from robotkube.registry.catalogue.core.applications import TOPIC_KEYS, TOPIC_KEYS_OPTIONAL
from robotkube.robots.bridge.core.rights import IN, OUT

End = tuple[str, str]
"""A bridge: kind of link and place."""

Part = dict[str, dict[str, Mapping[str, Any]]]
"""Topics of one bridge by direction and name."""

Whose = Callable[[End, str], str]
"""Who asked for a topic of a bridge, as a clause: `for task ops/t (application a)`."""


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

    def add(self, kind: str, agent: str, direction: str, topic: Mapping[str, Any], whose: Whose) -> None:
        """Add one topic; RefusalError(CompositionFailed) when the bridge has it otherwise or in the other direction,
        with who asked for that in the words of `whose`."""
        part: Part = {OUT: {}, IN: {}}
        part[direction][topic["name"]] = topic
        one = MergedTopics()
        one._topics[kind, agent] = part
        self.merge(one, whose)

    def merge(self, other: MergedTopics, whose: Whose) -> None:
        """Merge all of `other` into these, or refuse as `add` does and stay as they were."""
        for end, part in other._topics.items():
            mine = self._topics.get(end)
            if mine is not None:
                _agree(end, mine, part, whose)
        for end, part in other._topics.items():
            mine = self._topics.setdefault(end, part)
            if mine is not part:
                if end not in self._own:
                    mine = self._topics[end] = {direction: dict(topics) for direction, topics in mine.items()}
                    self._own.add(end)
                for direction, topics in part.items():
                    mine[direction].update(topics)

    def names(self, end: End, direction: str) -> Iterable[str]:
        """The names of the topics of one bridge in one direction."""
        return self._topics.get(end, {}).get(direction, {}).keys()

    def at(self, kind: str, agent: str) -> dict[str, Sequence[Mapping[str, Any]]]:
        """Topics of one bridge by direction, by name."""
        part = self._topics.get((kind, agent), {})
        both = {direction: part.get(direction, {}) for direction in (OUT, IN)}
        return {direction: [topics[name] for name in sorted(topics)] for direction, topics in both.items()}


def _agree(end: End, mine: Part, part: Part, whose: Whose) -> None:
    for direction, topics in part.items():
        present, against = mine[direction], mine[IN if direction == OUT else OUT]
        for name, topic in topics.items():
            known = present.get(name)
            if known is not None and known is not topic and known != topic:
                raise _difference(end, known, topic, whose)
            if name in against:
                ways = ("leaves", "enter") if direction == IN else ("enters", "leave")
                raise RefusalError(
                    "CompositionFailed",
                    f"topic {name} {ways[0]} {end[1]} by its {end[0]} bridge {whose(end, name)}, and would {ways[1]} "
                    "by it as well: a loop; give one of both topics another name",
                )


def _difference(end: End, present: Mapping[str, Any], topic: Mapping[str, Any], whose: Whose) -> RefusalError:
    name = topic["name"]
    there, here = (", ".join(words) for words in zip(*_differences(present, topic), strict=True))
    return RefusalError(
        "CompositionFailed",
        f"topic {name} is asked for with {here} at the {end[0]} bridge of {end[1]}, which carries it with {there} "
        f"{whose(end, name)}: a bridge carries a topic in one way; write the same in both links",
    )


def _differences(present: Mapping[str, Any], topic: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What differs, in words: as it is, and as it is asked for."""
    for key in (*TOPIC_KEYS, *TOPIC_KEYS_OPTIONAL):
        one, other = present.get(key), topic.get(key)
        if one != other:
            yield _word(key, one), _word(key, other)


def _word(key: str, value: Any) -> str:
    return f"no {key}" if value is None else f"{key} {value}"
