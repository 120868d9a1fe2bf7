"""A sender that is fenced: it sends only while its release is its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robotkube.foundation.runtime.loops.fencing import Fencing

if TYPE_CHECKING:
    from robotkube.robots.reactions.ports.deliveries import DeliverySender, EdgeDelivery


class FencedSender:
    """A sender (port Sender) that sends nothing while the process is not sure that its release is still its own."""

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
