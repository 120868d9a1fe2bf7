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
    "writers without signing in": (
        {
            "console": {
                "anybodyReads": True,
                "signIn": {"issuer": "", "writers": [{"group": "robotkube", "namespaces": ["cloud-0"]}]},
            }
        },
        "console.signIn.writers names groups, but console.signIn.issuer is empty: without signing in nobody writes.",
    ),
    "writers in the name of nobody": (
        {"console": {"signIn": {"writers": [{"group": "robotkube", "namespaces": ["argocd"]}]}}},
        "console.signIn.writers: group robotkube may ask in namespace argocd, which is no agent's. Name agents (",
    ),
    "writers who do not read": (
        {"console": {"signIn": {"writers": [{"group": "others", "namespaces": ["cloud-0"]}]}}},
        "console.signIn.writers: group others is not in console.signIn.groups, so its members may not even read.",
    ),
    "signing in, and everybody": (
        {"console": {"anybodyReads": True}},
        "console.anybodyReads is true, but console.signIn.issuer is set. Take one of the two out.",
    ),
}
