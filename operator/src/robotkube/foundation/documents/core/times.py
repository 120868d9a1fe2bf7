"""Times as RFC 3339 texts and as nanoseconds since 1970."""

from __future__ import annotations

from datetime import UTC, datetime


def time_text(nanoseconds: int) -> str:
    """The time so many nanoseconds after 1970 began, in RFC 3339, UTC, with microseconds."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1000:06d}Z"


def second_text(nanoseconds: int) -> str:
    """The same in whole seconds: for people, who read it beside others."""
    return f"{datetime.fromtimestamp(nanoseconds // 1_000_000_000, UTC):%Y-%m-%dT%H:%M:%SZ}"


def time_ns(text: str) -> int:
    """The time in `text` (RFC 3339) in ns since 1970; ValueError when it is none."""
    moment = datetime.fromisoformat(text)
    return int(moment.replace(microsecond=0).timestamp()) * 1_000_000_000 + moment.microsecond * 1000
