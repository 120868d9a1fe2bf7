"""The messages of a bag, as a detector's buffers are filled with them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from robotkube.robots.bags.adapters.reading import open_bag


def read_bag(
    path: Path, complain: Callable[[str], None], wanted: Callable[[str, str], bool]
) -> Iterator[tuple[str, str, int, bytes]]:
    """The topic, type, time in ns and bytes of a bag's messages; `wanted`: true for topics and types to be read."""
    with open_bag(path, complain) as bag:
        types = {topic.name: topic.type for topic in bag.topics}
        for topic, time, data in bag.messages({name for name, kind in types.items() if wanted(name, kind)}):
            yield topic, types[topic], time, data
