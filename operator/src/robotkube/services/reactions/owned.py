"""What is sent only by who still owns the release."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robotkube.services.ownership import Ownership

if TYPE_CHECKING:
    from robotkube.ports.reactions import Delivery, Sender


class OwnedSender:
    """A sender (port Sender) that sends nothing while the process is not sure that its release is still its own."""

    def __init__(self, sender: Sender, ownership: Ownership) -> None:
        self._sender, self._ownership = sender, ownership

    def probe(self) -> None:
        """See the port."""
        self._sender.probe()

    def send(self, delivery: Delivery) -> None:
        """See the port."""
        self._ownership.check()
        self._sender.send(delivery)

    def close(self) -> None:
        """See the port."""
        self._sender.close()
