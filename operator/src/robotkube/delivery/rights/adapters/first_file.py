"""The file that the broker's plugin begins with, on its volume: hashed passwords, and lists that were there."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from pathlib import Path
from typing import Any

from robotkube.delivery.rights.core.control import Password
from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.runtime.process import read_text

ITERATIONS = 101  # the plugin's own number: passwords are 240 random bits, which nobody guesses from a hash
SALT_BYTES = 12
DIGEST_BYTES = 64


def read_passwords(path: Path) -> dict[str, str]:
    """Account -> password, from lines of `account:password`; InputError names a line that is none."""
    passwords = {}
    for number, line in enumerate(read_text(path, "the accounts' passwords").splitlines(), 1):
        name, colon, password = line.partition(":")
        if not (name and colon and password):
            raise InputError(f"{path}:{number}: must be `account:password`")
        passwords[name] = password
    return passwords


def hashed(password: str) -> Password:
    """A password as the plugin keeps it."""
    salt = os.urandom(SALT_BYTES)
    digest = hashlib.pbkdf2_hmac("sha512", password.encode(), salt, ITERATIONS, DIGEST_BYTES)
    return Password(base64.b64encode(digest).decode(), base64.b64encode(salt).decode(), ITERATIONS)


def read_before(path: Path) -> Any:
    """The file as the broker left it; None when there is none, or none that can be read."""
    try:
        return read_json(path.read_bytes())
    except (OSError, ValueError):
        return None


def write_file(path: Path, document: Any) -> None:
    """Write the file, which nobody else can read; what was there stays until it is whole."""
    beside = path.with_name(f"{path.name}.first")
    beside.unlink(missing_ok=True)
    with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
        json.dump(document, file)
    beside.replace(path)
