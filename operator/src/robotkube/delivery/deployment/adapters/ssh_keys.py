"""SSH keys of people, for break-glass: signatures by ed25519 keys in OpenSSH's files (cryptography)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_ssh_private_key

from robotkube.delivery.deployment.core.break_glass import read_signature, to_sign, write_signature
from robotkube.errors import InputError


def sign(path: Path, statement: bytes, passphrase: Callable[[], str]) -> tuple[bytes, str]:
    """The public key of the private one in `path`, and its signature over `statement`; `passphrase` is asked when the
    file is encrypted. InputError when the file holds no ed25519 key."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    key = _load(path, data, None) or _load(path, data, passphrase().encode())
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"{path}: no private key of type ssh-ed25519; make one with ssh-keygen -t ed25519")
    public = key.public_key().public_bytes_raw()
    return public, write_signature(public, key.sign(to_sign(statement)))


def _load(path: Path, data: bytes, passphrase: bytes | None) -> object | None:
    """The key; None when it needs a passphrase and none was given."""
    try:
        return load_ssh_private_key(data, passphrase)
    except TypeError:  # encrypted, and no passphrase given
        return None
    except (ValueError, UnsupportedAlgorithm) as error:
        raise InputError(f"{path}: no private key that can be read, or another passphrase: {error}") from error


def holds(signature: str, keys: Iterable[bytes], statement: bytes) -> bool:
    """Return whether it is a signature over `statement` by one of these public keys."""
    read = read_signature(signature)
    if read is None or read[0] not in keys:
        return False
    try:
        Ed25519PublicKey.from_public_bytes(read[0]).verify(read[1], to_sign(statement))
    except InvalidSignature:
        return False
    return True
