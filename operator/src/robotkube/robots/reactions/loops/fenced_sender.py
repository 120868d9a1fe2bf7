"""A sender that sends nothing while the release is fenced."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robotkube.foundation.runtime.loops.fencing import Fencing

if TYPE_CHECKING:
    from robotkube.robots.reactions.ports.deliveries import DeliverySender, EdgeDelivery


class FencedSender:
    """A sender (port DeliverySender) that sends nothing while the process is not sure that its release is its own."""

    def __init__(self, sender: DeliverySender, fencing: Fencing) -> None:
        self._sender = sender
        self._fencing = fencing

    def probe(self) -> None:
        """See the port."""
        self._sender.probe()

    def send(self, delivery: EdgeDelivery) -> None:
        """See the port."""
        self._fencing.check()
        self._sender.send(delivery)

    def close(self) -> None:
        """See the port."""
        self._sender.close()
