"""Bags of a command line: opened, their types put together, their messages merged by time."""

from __future__ import annotations

import heapq
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from robotkube.errors import InputError
from robotkube.robots.bags.adapters.reading import OpenBag, open_bag
from robotkube.robots.bags.core.playback import restamped
from robotkube.robots.ros.adapters.installed_definitions import definition
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.ros.core.common_messages import STAMPED_TYPES
from robotkube.robots.ros.core.message_definitions import Definitions, read_definitions

BAGS_MAX = 1000


class Bags:
    """Several bags as one; to be closed. `complain` hears of damage. InputError when one cannot be read at all."""

    def __init__(self, paths: Sequence[Path], complain: Callable[[str], None]) -> None:
        if len(paths) > BAGS_MAX:
            raise InputError(f"{len(paths)} bags; at most {BAGS_MAX} are read at once")
        self._stack = ExitStack()
        try:
            self._bags: list[OpenBag] = [self._stack.enter_context(open_bag(path, complain)) for path in paths]
        except BaseException:
            self.close()
            raise
        self.types = _types(self._bags, complain)
        _compare_definitions(self._bags, complain)
        self._definitions: dict[str, str] = {}
        for bag in reversed(self._bags):
            self._definitions |= bag.definitions
        self.layouts = Layouts(self.definition)

    def definition(self, type_name: str) -> str:
        """The type's definition, as a bag brings it, else as it is installed; KeyError without either."""
        text = self._definitions.get(type_name) or definition(type_name, Path(sys.prefix) / "share")
        if not text:
            raise KeyError(type_name)
        return text

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time in ns and message of all bags, in the order of the times."""
        streams = [bag.messages(wanted) for bag in self._bags]
        return streams[0] if len(streams) == 1 else heapq.merge(*streams, key=_moment)

    def played(self, wanted: Collection[str], start: int) -> Iterator[tuple[str, int, bytes]]:
        """The messages as players publish them in a run that begins at `start` (ns since 1970)."""
        for name, moment, data in self.messages(wanted):
            due = start + moment
            yield name, due, restamped(data, due) if self.types[name] in STAMPED_TYPES else data

    def close(self) -> None:
        """Close them all."""
        self._stack.close()

    def __enter__(self) -> Bags:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _types(bags: Sequence[OpenBag], complain: Callable[[str], None]) -> Mapping[str, str]:
    types: dict[str, str] = {}
    for bag in bags:
        for topic in bag.topics:
            known = types.setdefault(topic.name, topic.type)
            if known != topic.type:
                complain(f"{bag.path}: {topic.name} is {topic.type}, but {known} in another bag; they are mixed up")
    return types


def _compare_definitions(bags: Sequence[OpenBag], complain: Callable[[str], None]) -> None:
    """Complain where a bag's definition of a type has other fields than the first bag's, which counts for all."""
    known: dict[str, tuple[Path, Definitions]] = {}
    for bag in bags:
        for name in sorted({topic.type for topic in bag.topics} & set(bag.definitions)):
            try:
                fields = read_definitions(name, bag.definitions[name])
            except ValueError:
                continue  # reported where it is read
            first, expected = known.setdefault(name, (bag.path, fields))
            if fields != expected:
                complain(f"{bag.path}: {name} has other fields than in {first}, and is read as there; test it alone")


def _moment(message: tuple[str, int, bytes]) -> int:
    return message[1]
