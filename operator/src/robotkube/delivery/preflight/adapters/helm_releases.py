"""Revisions of a Helm release as Helm keeps them: Secrets with a compressed document, of which nothing is shown."""

from __future__ import annotations

import base64
import binascii
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.delivery.preflight.core.releases import HelmRevision
from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json

DOCUMENT_BYTES_MAX = 32 * 1024 * 1024
GZIP = 16 + zlib.MAX_WBITS


def selector(release: str) -> str:
    """The labels of the Secrets of a release."""
    return f"owner=helm,name={release}"


def last_revision(secrets: Sequence[Mapping[str, Any]]) -> HelmRevision | None:
    """The last revision; None when there is none. InputError when it cannot be read."""
    if not secrets:
        return None
    last = max(secrets, key=lambda one: int((one["metadata"].get("labels") or {}).get("version", 0)))
    name = last["metadata"]["name"]
    try:
        text = base64.b64decode(base64.b64decode((last.get("data") or {})["release"]))
        document = read_json(_inflated(text))
        metadata, info = document["chart"]["metadata"], document["info"]
        values = document.get("config") or {}
        return HelmRevision(str(metadata["version"]), str(info["status"]), int(document["version"]), values)
    except (KeyError, TypeError, ValueError, binascii.Error, zlib.error) as error:
        raise InputError(
            f"Secret {name} holds no revision of Helm that is understood ({type(error).__name__})"
        ) from error


def _inflated(data: bytes) -> bytes:
    inflating = zlib.decompressobj(GZIP)
    text = inflating.decompress(data, DOCUMENT_BYTES_MAX)
    if inflating.unconsumed_tail:
        raise ValueError("longer than is read")
    return text
