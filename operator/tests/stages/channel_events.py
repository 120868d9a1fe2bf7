"""The owner of a connection to a broker that keeps what the connection reports, and does nothing about it."""

from __future__ import annotations


class KeptEvents:
    """Port ChannelEvents: messages, sessions, acknowledgements and refusals, in the order in which they came."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, bytes]] = []
        self.acknowledgements: dict[int, bool] = {}
        self.sessions: list[bool] = []
        self.losses = 0
        self.refusals: list[str] = []
        self.properties: list[bytes] = []

    def connected(self, session_kept: bool) -> None:
        self.sessions.append(session_kept)

    def disconnected(self) -> None:
        self.losses += 1

    def acknowledged(self, token: int, heard: bool) -> None:
        self.acknowledgements[token] = heard

    def refused(self, topic: str, reason: str) -> None:
        self.refusals.append(reason)

    def granted(self, topic: str) -> None: ...

    def rejected(self, token: int, reason: str) -> None:
        self.refusals.append(reason)

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        self.messages.append((topic, payload))
        self.properties.append(properties)
