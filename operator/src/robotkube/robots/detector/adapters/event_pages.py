"""The page `/events` of a running detector."""

from __future__ import annotations

import urllib.error
import urllib.request
from collections.abc import Mapping
from typing import Any

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json

ANSWER_SECONDS_MAX = 10.0
ANSWER_BYTES_MAX = 64 * 1024 * 1024
PAGE = "/events"


def events_page(address: str) -> Mapping[str, Any]:
    """`GET /events` of the detector at `http://host:port`; UnavailableError when it does not answer."""
    url = address if address.rstrip("/").endswith(PAGE) else f"{address.rstrip('/')}{PAGE}"
    if not url.startswith(("http://", "https://")):
        raise InputError(f"{address!r} must begin with http:// or https://")
    try:
        with urllib.request.urlopen(url, timeout=ANSWER_SECONDS_MAX) as answer:  # noqa: S310  # checked above
            document = read_json(answer.read(ANSWER_BYTES_MAX))
    except (urllib.error.URLError, OSError, ValueError) as error:
        raise UnavailableError(f"{url}: {error}; is that the address of a running detector?") from error
    return document if isinstance(document, dict) else {}
