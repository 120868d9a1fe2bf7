"""Leadership: which of a manager's processes may write."""

from __future__ import annotations

from typing import Protocol


class Leadership(Protocol):
    """An election between the processes of one manager. Its methods only read what is known here."""

    def term(self) -> int | None:
        """The number of the election under which this process may write now; None while it may not. A later leader has
        a higher number."""
        ...

    def leader(self) -> str | None:
        """`<host>:<port>` where the other process that leads now serves HTTP, as far as is known; None when this one
        leads, or none is known to."""
        ...

    def overtake(self, term: int) -> None:
        """Main has `term` from this manager already: a process that leads with a lower or none is elected again, with a
        higher one."""
        ...
