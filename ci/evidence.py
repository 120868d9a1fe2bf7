"""The key that signs evidence in embedded clusters, and the evidence it signed: both outlive the clusters, so that what
did not change is not verified again.

    <user cache>/evidence/key.pem                 ed25519, PKCS #8, readable by this user only
    <user cache>/evidence/<key id>/evidence/...   envelopes, as in the catalogue
"""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from ci.errors import SetUpError
from ci.folders import user_cache
from robotkube.errors import InputError
from robotkube.registry.evidence.adapters.dsse import KeyFile
from robotkube.registry.evidence.adapters.key_pairs import new_key_pair

OWNER_ONLY = 0o600


def folder() -> Path:
    """The folder of key and evidence."""
    return user_cache() / "evidence"


def key_file(place: Path | None = None) -> Path:
    """The private key, made when it is not there."""
    path = (place or folder()) / "key.pem"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        _make(path)
    return path


def signing_key(place: Path | None = None) -> KeyFile:
    """The key with its id and public half; SetUpError when the file holds none."""
    path = key_file(place)
    try:
        return KeyFile(path)
    except InputError as error:
        raise SetUpError(f"{error}; remove the file to get a new key, and verify everything again") from error


def kept_folder(place: Path | None = None) -> Path:
    """Evidence that this key signed."""
    return (place or folder()) / signing_key(place).key_id


def _make(path: Path) -> None:
    """Another process may do the same: the first one's key stays."""
    text = new_key_pair().private.encode()
    part = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    with os.fdopen(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, OWNER_ONLY), "wb") as file:
        file.write(text)
    with contextlib.suppress(FileExistsError):
        os.link(part, path)
    part.unlink()
