"""A key that signs evidence, with its public half."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class KeyPair:
    """An ed25519 key as PEM: `private` (PKCS #8) is never shown, `public` is what others trust, `key_id` its name."""

    key_id: str
    public: str
    private: str = field(repr=False)
