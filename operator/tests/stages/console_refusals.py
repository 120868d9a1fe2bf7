"""What the platform's chart refuses of `console`: values, and the words of the message; others are those of
profiles/official.yaml."""

from __future__ import annotations

from typing import Any

CONSOLE_REFUSALS: dict[str, tuple[dict[str, Any], str]] = {
    "a console that nobody may read": (
        {"console": {"signIn": {"issuer": ""}}},
        "console.enabled is true, but nobody may read: console.signIn.issuer is empty. Name the provider",
    ),
    "a provider without a client": (
        {"console": {"signIn": {"clientId": ""}}},
        "console.signIn: issuer needs clientId (of the client at the provider), url",
    ),
    "signing in, and everybody": (
        {"console": {"anybodyReads": True}},
        "console.anybodyReads is true, but console.signIn.issuer is set. Take one of the two out.",
    ),
}
