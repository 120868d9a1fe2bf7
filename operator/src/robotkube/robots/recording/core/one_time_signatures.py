"""Signatures by a key that can sign once: LM-OTS of RFC 8554 (NIST SP 800-208), parameters LMOTS_SHA256_N32_W4. Pure.

They need SHA-256 and nothing else, so a recorder's image needs no library for them. A key is made for one seal: a
second signature by it would help a forger, so whoever has signed forgets it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

TYPE = 3
SEED_BYTES = 32
IDENTIFIER_BYTES = 16
_WIDTH = 4
_LAST = 2**_WIDTH - 1
_CHAINS = 67
_DIGITS = 64
_SHIFT = 4
_PUBLIC, _MESSAGE, _RANDOMISER = 0x8080, 0x8181, 0xFFFD
_HEAD = TYPE.to_bytes(4, "big")
_SIGNATURE_BYTES = 4 + 32 * (1 + _CHAINS)
_PUBLIC_BYTES = 4 + IDENTIFIER_BYTES + 4 + 32


@dataclass(frozen=True)
class OneTimeKey:
    """A private key, drawn by whoever makes it: `identifier` is public, `seed` is secret. `number` is the RFC's q."""

    identifier: bytes
    seed: bytes = field(repr=False)
    number: int = 0

    @property
    def public(self) -> bytes:
        """The public half."""
        prefix = _prefix(self.identifier, self.number)
        ends = [_chained(prefix, i, start, 0, _LAST) for i, start in enumerate(_starts(prefix, self.seed))]
        return _public(prefix, ends)

    def sign(self, message: bytes) -> bytes:
        """The signature of one message; never ask for a second one."""
        prefix = _prefix(self.identifier, self.number)
        randomiser = _derived(prefix, _RANDOMISER, self.seed)
        digits = _digits(_message_digest(prefix, randomiser, message))
        starts = enumerate(_starts(prefix, self.seed))
        values = [_chained(prefix, i, start, 0, digit) for (i, start), digit in zip(starts, digits, strict=True)]
        return b"".join((_HEAD, randomiser, *values))


def holds(message: bytes, signature: bytes, public: bytes) -> bool:
    """Return whether the key with this public half has signed this message."""
    whole = len(signature) == _SIGNATURE_BYTES and len(public) == _PUBLIC_BYTES
    if not whole or signature[:4] != _HEAD or public[:4] != _HEAD:
        return False
    prefix = public[4:-32]
    randomiser = signature[4:36]
    values = [signature[start : start + 32] for start in range(36, _SIGNATURE_BYTES, 32)]
    digits = _digits(_message_digest(prefix, randomiser, message))
    ends = [_chained(prefix, i, values[i], digit, _LAST) for i, digit in enumerate(digits)]
    return _public(prefix, ends) == public


def _prefix(identifier: bytes, number: int) -> bytes:
    return identifier + number.to_bytes(4, "big")


def _starts(prefix: bytes, seed: bytes) -> Iterator[bytes]:
    return (_derived(prefix, i, seed) for i in range(_CHAINS))


def _derived(prefix: bytes, number: int, seed: bytes) -> bytes:
    """A secret value, derived from the seed as appendix A of the RFC says."""
    return _digest(prefix + number.to_bytes(2, "big") + b"\xff" + seed)


def _chained(prefix: bytes, chain: int, value: bytes, first: int, last: int) -> bytes:
    """The value `last - first` steps further along its chain."""
    head = prefix + chain.to_bytes(2, "big")
    for step in range(first, last):
        value = _digest(head + bytes((step,)) + value)
    return value


def _public(prefix: bytes, ends: Sequence[bytes]) -> bytes:
    return _HEAD + prefix + _digest(prefix + _PUBLIC.to_bytes(2, "big") + b"".join(ends))


def _message_digest(prefix: bytes, randomiser: bytes, message: bytes) -> bytes:
    return _digest(prefix + _MESSAGE.to_bytes(2, "big") + randomiser + message)


def _digits(digest: bytes) -> list[int]:
    """The digits of a digest and of their checksum: who raises one digit has to lower another."""
    digits = [half for byte in digest for half in (byte >> _WIDTH, byte & _LAST)]
    checksum = sum(_LAST - digit for digit in digits) << _SHIFT
    more = [half for byte in checksum.to_bytes(2, "big") for half in (byte >> _WIDTH, byte & _LAST)]
    return digits + more[: _CHAINS - _DIGITS]


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()
