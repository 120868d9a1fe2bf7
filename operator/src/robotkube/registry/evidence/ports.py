"""Signing statements and verifying what was signed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from robotkube.registry.evidence.core.statements import VerifiedStatement


class Signer(Protocol):
    """The gate's key."""

    @property
    def key_id(self) -> str:
        """Id of the key: the first 16 hex of the SHA-256 over its public key (DER SubjectPublicKeyInfo)."""
        ...

    @property
    def public_key(self) -> str:
        """The public key as PEM text, as it stands in the catalogue (`keys/<key id>.pem`)."""
        ...

    def sign(self, statement: Mapping[str, Any]) -> bytes:
        """The statement in a signed envelope: canonical JSON, ASCII, without a newline at its end. Its digest is the
        SHA-256 of these bytes. InputError when the statement is not one that `Verifier.verify` accepts."""
        ...


class Verifier(Protocol):
    """The keys that are trusted here. Safe for several threads."""

    def trusted(self) -> frozenset[str]:
        """Ids of the keys trusted now, read again when they were changed. InputError names a key file that cannot be
        read."""
        ...

    def verify(self, envelope: bytes) -> VerifiedStatement:
        """The statement, when the envelope is one of ours, unchanged and signed by a trusted key.

        InputError says in plain words why not; every size and depth is bounded, nothing else is ever raised."""
        ...
