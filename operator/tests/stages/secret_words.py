"""What a Secret says in words, also one in which Helm keeps a release."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping
from typing import Any


def words(secret: Mapping[str, Any]) -> str:
    """All of its values; a release of Helm's is compressed and encoded once more."""
    values = [base64.b64decode(value) for value in (secret.get("data") or {}).values()]
    if secret["type"] == "helm.sh/release.v1":
        values = [gzip.decompress(base64.b64decode(value)) for value in values]
    return "".join(value.decode(errors="replace") for value in values)
