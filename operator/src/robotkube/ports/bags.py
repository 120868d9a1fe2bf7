"""Bags as sources of messages for tools."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Protocol

from robotkube.domain.bags import BagTopic


class BagSource(Protocol):
    """One bag, read as far as it is readable."""

    @property
    def topics(self) -> Sequence[BagTopic]:
        """The topics in the bag."""
        ...

    @property
    def definitions(self) -> Mapping[str, str]:
        """Type -> its definition with those of the types it uses, for the types whose definition the bag brings."""
        ...

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of recording in ns and serialised message, times ascending; of the topics `wanted`, all when
        None."""
        ...
