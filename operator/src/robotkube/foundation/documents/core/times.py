"""Times as RFC 3339 texts and as nanoseconds since 1970."""

from __future__ import annotations

from datetime import UTC, datetime


def time_text(time: int) -> str:
    """RFC 3339 in UTC with microseconds, of ns since 1970."""
    seconds, rest = divmod(time, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1000:06d}Z"


def time_ns(text: str) -> int:
    """ns since 1970 of an RFC 3339 time in UTC; ValueError when it is none."""
    moment = datetime.fromisoformat(text)
    return int(moment.replace(microsecond=0).timestamp()) * 1_000_000_000 + moment.microsecond * 1000
