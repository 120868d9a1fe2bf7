"""The interface of reactions that installed packages add. Public API; docs/how-to/write-a-plugin.md shows a whole
package.

A package names a factory in the entry point group `robotkube.reactions`. The factory gets the reaction's `settings` and
gives an object with `react`. It runs in a process of its own, one edge after the other: what it does with time and
memory harms nobody else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

ENTRY_POINT_GROUP = "robotkube.reactions"


class InstalledReaction(Protocol):
    """The object that a factory gives."""

    def react(self, event: Mapping[str, Any]) -> None:
        """React to an edge, given as the document of docs/reference/event-detector.md.

        Returns when it is done. An exception, or no return within `timeout_seconds`: it is called again with the same
        document, whose `id` shows a repetition. `ValueError`: this edge is given up.
        """
        ...


Factory = Callable[[Mapping[str, Any]], InstalledReaction]
