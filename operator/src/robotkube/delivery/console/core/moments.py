"""Times as the console's page has them: whole milliseconds since 1970, None where nobody knows them."""

from __future__ import annotations

from typing import Any

from robotkube.foundation.documents.core.times import time_ns

NS_OF_MS = 1_000_000


def text_ms(text: Any) -> int | None:
    """Of a time as Kubernetes writes it; None when it is none."""
    try:
        return time_ns(text) // NS_OF_MS
    except (ValueError, TypeError, OverflowError):
        return None


def ns_ms(nanoseconds: Any) -> int | None:
    """Of ns since 1970; None when it is no number."""
    return nanoseconds // NS_OF_MS if type(nanoseconds) is int else None
