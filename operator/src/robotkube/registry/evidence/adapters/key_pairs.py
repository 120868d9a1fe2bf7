"""Key pairs from the operating system's randomness and from PEM files (cryptography)."""

from __future__ import annotations

from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from robotkube.registry.evidence.adapters.dsse import key_id, read_private_key
from robotkube.registry.evidence.core.key_pairs import KeyPair


def new_key_pair() -> KeyPair:
    """Another key each time."""
    return _pair(Ed25519PrivateKey.generate())


def read_key_pair(path: Path) -> KeyPair | None:
    """The key in a PEM file, None when there is no such file; InputError names one that holds no ed25519 key."""
    return _pair(read_private_key(path)) if path.exists() else None


def _pair(key: Ed25519PrivateKey) -> KeyPair:
    public = key.public_key()
    return KeyPair(
        key_id=key_id(public),
        public=public.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode(),
        private=key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode(),
    )
