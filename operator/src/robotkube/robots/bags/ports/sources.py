"""Bags as sources of messages for tools."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Protocol


class BagSource(Protocol):
    """Messages of one or more bags, as far as they are readable."""

    @property
    def types(self) -> Mapping[str, str]:
        """Topic -> its type."""
        ...

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of recording in ns and serialised message, times ascending; of the topics `wanted`, all when
        None."""
        ...
