"""What the platform's chart refuses of `console`: values, and the words of the message."""

from __future__ import annotations

from typing import Any

CLIENT = {"clientId": "a", "url": "https://console.example", "groups": ["a"]}
CONSOLE_REFUSALS: dict[str, tuple[dict[str, Any], str]] = {
    "a console that nobody may read": (
        {"console": {"enabled": True}},
        "console.enabled is true, but nobody may read: console.signIn.issuer is empty. Name the provider",
    ),
    "a provider without a client": (
        {"console": {"enabled": True, "signIn": {"issuer": "https://forge.example"}}},
        "console.signIn: issuer needs clientId (of the client at the provider), url",
    ),
    "signing in, and everybody": (
        {"console": {"enabled": True, "anybodyReads": True, "signIn": {"issuer": "https://forge.example", **CLIENT}}},
        "console.anybodyReads is true, but console.signIn.issuer is set. Take one of the two out.",
    ),
}
