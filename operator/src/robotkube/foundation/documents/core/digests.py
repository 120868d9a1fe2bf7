"""Digests of bytes, and the one JSON text of a document that they are taken of."""

from __future__ import annotations

import hashlib
import json
from typing import Any


def sha256(data: bytes) -> str:
    """The SHA-256 digest of `data` in OCI form."""
    return "sha256:" + hashlib.sha256(data).hexdigest()


def canonical_json(document: Any) -> bytes:
    """The JSON of a document as it is hashed: keys sorted, no spaces."""
    return json.dumps(document, sort_keys=True, separators=(",", ":")).encode()
