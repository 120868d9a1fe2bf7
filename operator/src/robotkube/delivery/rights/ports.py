"""What keeping rights needs: the broker's own control, and what is told of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol


class BrokerControl(Protocol):
    """The broker, as its owner of rights speaks to it. For one thread."""

    @property
    def connections(self) -> int:
        """How often the broker took the connection."""
        ...

    @property
    def complaint(self) -> str | None:
        """Why there is no connection; None while there is one."""
        ...

    def turn(self) -> None:
        """Connect when that is due, keep the connection, read what came."""
        ...

    def ask(self, requests: Sequence[Mapping[str, Any]]) -> Sequence[Mapping[str, Any]]:
        """The answers to requests, in their order; UnavailableError when the broker does not answer, InputError when it
        refuses one."""
        ...

    def close(self) -> None:
        """Leave the broker."""
        ...
